"""Several keyframes solved at once: the start, the refinement."""
