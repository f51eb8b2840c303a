"""Devices of the robot: the ports (interfaces) and their simulated, recorded and Raspberry Pi adapters."""
