"""Names with meaning for rooms, each a suggestion with its evidence."""
