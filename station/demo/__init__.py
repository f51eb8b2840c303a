"""The demo: simulated robot, robot-server and station as separate programs, a mapping drive, a hijack, a second drive."""
