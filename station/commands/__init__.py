"""One file per command of the `station` program, imported when it is called. Each has `register(app)`."""
