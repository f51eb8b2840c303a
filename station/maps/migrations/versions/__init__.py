"""Changes of the map store's tables, in order; run by station/maps/database.py."""
