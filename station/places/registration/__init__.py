"""Registration: how one point cloud lies in another's frame, with scale, or a reasoned no."""
