"""What every backend uses: tracks, loops, bundle adjustment."""
