"""Everything that belongs to one robot."""
