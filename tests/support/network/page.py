"""A page's two sockets without a browser: pictures as they come, and a joystick held as a person holds it."""

from __future__ import annotations

import asyncio
import json
import math
import time
from dataclasses import dataclass

import websockets

from station.api.streams import HEADER
from tests.support.network.judging import Hold, numbered

# As the page has them: station/web/src/drive/control.ts, line.ts, safety.ts.
REPEAT_S, TTL_MS, STALE_S = 0.05, 200, 0.5


@dataclass(frozen=True, slots=True)
class Picture:
    """One that came."""

    seq: int  # the robot's count of the pictures it takes
    arrived_ns: int
    t_robot_ns: int  # when it was taken
    num_bytes: int

    @property
    def age_ms(self) -> float:
        """Where robot and page have one clock."""
        return (self.arrived_ns - self.t_robot_ns) * 1e-6


class Viewer:
    """Takes pictures from /ws/camera."""

    def __init__(self) -> None:
        self.pictures: list[Picture] = []
        self._taken_ns = -math.inf  # of the newest picture, by the age that the station gave with it; ours to know

    @property
    def age_s(self) -> float:
        """Of the newest picture, as the page believes."""
        return (time.monotonic_ns() - self._taken_ns) * 1e-9

    async def run(self, address: str) -> None:
        """Until cancelled."""
        async with websockets.connect(f"{address}/ws/camera", max_size=None) as socket:
            async for content in socket:
                arrived_ns = time.monotonic_ns()
                assert isinstance(content, bytes)
                seq, _, _, t_robot_ns, age_s, _, _ = HEADER.unpack_from(content)
                self.pictures.append(Picture(seq, arrived_ns, t_robot_ns, len(content) - HEADER.size))
                self._taken_ns = -math.inf if math.isnan(age_s) else arrived_ns - age_s * 1e9
                await socket.send("")


class Joystick:
    """Sends numbered commands while it is held; no command, but a stop, while the picture is too old, as the page."""

    def __init__(self, viewer: Viewer, stale_s: float = STALE_S) -> None:
        self._viewer, self._stale_s = viewer, stale_s
        self._heard_ms: int | None = None
        self._seq = 0
        self.refusals: list[str] = []  # the station's, in words
        self.ticks = self.blind_ticks = 0  # and those of them at which the picture was too old

    async def run(self, address: str) -> None:
        """Connect and hear, until cancelled."""
        async with websockets.connect(f"{address}/ws/drive?driver=bench") as self._socket:
            async for answer in self._socket:
                message = json.loads(answer)
                if message["type"] == "time":
                    self._heard_ms = message["t_ms"]
                elif message["type"] == "refused":
                    self.refusals.append(message["text"])

    async def hold(self, hold: Hold, seconds: float, linear_m_s: float) -> None:
        """Hold it for so long; letting go is for the caller."""
        end_s = time.monotonic() + seconds
        due_s = time.monotonic()
        was_blind = False
        while time.monotonic() < end_s:
            is_blind = self._viewer.age_s > self._stale_s
            self.ticks += 1
            self.blind_ticks += is_blind
            if not is_blind:
                await self._drive(hold, linear_m_s)
            elif not was_blind:
                await self.let_go()
            was_blind = is_blind
            due_s = max(due_s + REPEAT_S, time.monotonic())
            await asyncio.sleep(due_s - time.monotonic())

    async def let_go(self) -> None:
        await self._socket.send(json.dumps({"type": "stop", "reason": ""}))

    async def _drive(self, hold: Hold, linear_m_s: float) -> None:
        linear, angular = numbered(len(hold.sent_ns), linear_m_s)
        self._seq += 1
        command = {"type": "drive", "seq": self._seq, "linear": linear, "angular": angular, "ttl_ms": TTL_MS}
        hold.sent_ns.append(time.monotonic_ns())
        await self._socket.send(json.dumps({**command, "heard_ms": self._heard_ms}))
