"""One file per command of the `station` program. Each has `register(app)`; heavy imports stay inside the functions."""
