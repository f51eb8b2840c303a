"""From sensor data to the filter's first state, and to where the next segment begins."""
