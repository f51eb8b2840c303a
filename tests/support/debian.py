"""What Debian on a Raspberry Pi ships."""

from __future__ import annotations

DEBIAN_NUMPY = {"3.11": "1.24.2", "3.13": "2.2.4"}  # python3-numpy of bookworm, of trixie
