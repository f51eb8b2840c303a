"""How robots are found: their usual port, and the name under which they make themselves known (DNS-SD over mDNS)."""

SERVICE_TYPE = "_sentinel._tcp.local."
DEFAULT_PORT = 7400


def service_label(robot_id: str) -> str:
    """How a robot is called in DNS-SD; a number follows where another one has the name."""
    return robot_id.replace(".", "-")[:63] or "robot"
