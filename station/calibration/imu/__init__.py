"""An inertial unit's noise and errors from a recording at rest: what the estimation is told of it."""
