"""Errors raised by the robot system. Every message is one sentence that says what is wrong and what to do about it."""


class RobotSystemError(Exception):
    """Base of all errors that are ours; programs print its message without a traceback."""


class ProtocolError(RobotSystemError):
    """The conversation between robot and station broke its rules."""


class LocalProtocolError(ProtocolError):
    """We broke the rules: a bug on this side."""


class RemoteProtocolError(ProtocolError):
    """The peer broke the rules: tell it why and close."""


class HardwareError(RobotSystemError):
    """A device does not do what it should."""


class DeviceUnavailable(HardwareError):
    """A device could not be opened at start."""


class DeviceLost(HardwareError):
    """A device stopped answering while in use."""


class ConfigError(RobotSystemError):
    """A configuration value is wrong; names the key, the value and the allowed range."""


class DataError(RobotSystemError):
    """A file or folder cannot be used; names it and the remedy."""


class EstimationError(RobotSystemError):
    """An estimate cannot be made from what was given."""


class DegenerateGeometry(EstimationError):
    """The geometry leaves the answer open (points on one line, no parallax, ...)."""
