"""A navigation onto a map: align, match, merge."""
