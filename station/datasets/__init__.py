"""What is on disk, read as frames and IMU: ASL folders, image folders, videos, our recordings."""
