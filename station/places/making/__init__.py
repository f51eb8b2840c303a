"""Point cloud to clusters, places and their graph."""
