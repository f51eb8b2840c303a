"""A picture to a pose in the map."""
