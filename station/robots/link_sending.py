"""What is about to be sent to a robot: little, and the most urgent first."""

from __future__ import annotations

import asyncio

from shared.messages import Drive, Heartbeat, Hijack, Join, PanTilt, Prove, Received, StationMessage, Stop

SENDING_ORDER: tuple[type[StationMessage], ...] = (Prove, Join, Stop, Hijack, Drive, PanTilt, Heartbeat, Received)


class DueMessages:
    """Room for one message of each kind: the newest wins. One reader."""

    def __init__(self) -> None:
        self._due: dict[type[StationMessage], StationMessage] = {}
        self._fresh = asyncio.Event()

    def put(self, message: StationMessage) -> None:
        self._due[type(message)] = message
        self._fresh.set()

    def discard(self, kind: type[StationMessage]) -> None:
        """Do not send one of this kind."""
        self._due.pop(kind, None)

    def clear(self) -> None:
        self._due.clear()

    async def wait(self) -> None:
        """Until something was put since the last time."""
        await self._fresh.wait()
        self._fresh.clear()

    def pop(self) -> StationMessage | None:
        """The most urgent message; None when nothing is due."""
        kind = next((kind for kind in SENDING_ORDER if kind in self._due), None)
        return None if kind is None else self._due.pop(kind)
