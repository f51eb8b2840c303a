"""Values that flow between the rooms, and nothing that computes."""
