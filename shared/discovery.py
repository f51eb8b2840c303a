"""How robots are found: their usual port, and the name under which they make themselves known (DNS-SD over mDNS)."""

SERVICE_TYPE = "_sentinel._tcp.local."
DEFAULT_PORT = 7400
