"""Who may use the station, and which robots it knows."""
