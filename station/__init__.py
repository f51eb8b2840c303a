"""Programs that run on the PC: link, SLAM, places, maps, API and page."""
