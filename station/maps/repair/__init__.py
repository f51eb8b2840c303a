"""What is wrong in a map store, and setting it right."""
