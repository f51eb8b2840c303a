"""Places: clustering, the place graph, registration, matching, localisation and the current place. Pure NumPy."""
