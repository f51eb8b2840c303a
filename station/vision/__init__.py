"""From pictures to features, matches and camera geometry."""
