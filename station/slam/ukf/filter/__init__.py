"""The filter itself: state, propagation, measurements, update."""
