"""The emulator's process: carries IPv4 packets between two TUN devices as the conditions say.

Each line on stdin is answered by a line on stdout: `{}`, or new conditions for both directions; the answer is the
counts of each direction. It ends with its stdin.

    python -m tests.support.network.carrier ROBOT_FD STATION_FD SEED CONDITIONS
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import select
import sys
import time
from dataclasses import asdict
from typing import Any

from tests.support.network.conditions import Conditions
from tests.support.network.direction import Direction

PACKET_BYTES = 2048  # above the devices' MTU
AT_ONCE = 32  # packets read from one side before the other side and the clock are looked at
IDLE_S = 1.0


def carry(robot_fd: int, station_fd: int, seed: int, conditions: Conditions) -> None:
    """Carry packets until stdin ends."""
    begin_ns = time.monotonic_ns()
    robot_fd, station_fd = os.dup(robot_fd), os.dup(station_fd)  # low numbers: select knows those below 1024 only
    to_robot = Direction(conditions, f"{seed} to robot", begin_ns)
    to_station = Direction(conditions, f"{seed} to station", begin_ns)
    ways = {station_fd: (to_robot, robot_fd), robot_fd: (to_station, station_fd)}
    stdin = sys.stdin.buffer.fileno()
    while True:
        readable, _, _ = select.select([*ways, stdin], [], [], seconds_to_next(to_robot, to_station))
        for fd, (direction, sink) in ways.items():
            if fd in readable:
                read_packets(fd, direction)
            for packet in direction.arrived(time.monotonic_ns()):
                # Refused where the far end's device is just going away.
                with contextlib.suppress(OSError):
                    os.write(sink, packet)
        if stdin in readable:
            line = sys.stdin.buffer.readline()
            if not line:
                return
            if told := json.loads(line):
                to_robot.conditions = to_station.conditions = Conditions(**told)
            print(
                json.dumps({"to_robot": asdict(to_robot.counts), "to_station": asdict(to_station.counts)}), flush=True
            )


def seconds_to_next(*directions: Direction) -> float:
    due = [direction.next_due_ns for direction in directions if direction.next_due_ns is not None]
    return max(0.0, (min(due) - time.monotonic_ns()) * 1e-9) if due else IDLE_S


def read_packets(fd: int, direction: Direction) -> None:
    """What the kernel sends by itself (IPv6 that looks for neighbours) is left out: fates go by number."""
    with contextlib.suppress(BlockingIOError):
        for _ in range(AT_ONCE):
            packet = os.read(fd, PACKET_BYTES)
            if packet[0] >> 4 == 4:
                direction.send(packet, time.monotonic_ns())


def be_prompt() -> None:
    """Before all others at the processor, and no pauses: a late emulator would be a worse network than was asked."""
    gc.disable()  # nothing here forms cycles
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))


def main(robot_fd: str, station_fd: str, seed: str, conditions: str) -> None:
    be_prompt()
    told: dict[str, Any] = json.loads(conditions)
    carry(int(robot_fd), int(station_fd), int(seed), Conditions(**told))


if __name__ == "__main__":
    main(*sys.argv[1:])
