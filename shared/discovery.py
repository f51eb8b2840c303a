"""Under which name robots make themselves known in the local network (DNS-SD over multicast DNS)."""

SERVICE_TYPE = "_sentinel._tcp.local."
DEFAULT_PORT = 7400
