"""The demo: simulated robot, robot-server and station as separate programs; map, hijack, second drive."""
