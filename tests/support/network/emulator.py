"""Two network namespaces with an emulated network between them. Both ends have this kernel's real TCP.

    with Network(PROFILES["two walls"], seed=1) as network:
        with network.robot.entered():               # sockets made in here belong to the robot's namespace for good
            listener = bind(network.robot.address, 7400)
        with network.station.entered():             # so do processes, and what they open
            subprocess.Popen([...])
        await asyncio.create_subprocess_exec(*network.station.command("python", "-m", "station.main", ...))
        network.use(replace(PROFILES["two walls"], loss=1.0))   # an outage, until it is told otherwise
        network.counts()["to_station"].lost

Nothing is left when it is closed or its process is killed: the namespaces have no names and go with the last who uses
them. Needs root (CAP_SYS_ADMIN, CAP_NET_ADMIN) and /dev/net/tun: `missing_reason` tells what is missing.
"""

from __future__ import annotations

import ctypes
import fcntl
import json
import os
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any, TypeVar

from tests.support.network.conditions import Conditions
from tests.support.network.direction import Counts
from tests.support.paths import ROOT

T = TypeVar("T")
CLONE_NEWNET = 0x40000000  # linux/sched.h
OWN_NAMESPACE = "/proc/thread-self/ns/net"
# linux/if_tun.h, linux/sockios.h, linux/if.h
TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
SIOCGIFFLAGS, SIOCSIFFLAGS, SIOCSIFADDR, SIOCSIFNETMASK, SIOCSIFTXQLEN = 0x8913, 0x8914, 0x8916, 0x891C, 0x8943
IFF_UP = 0x1
DEVICE = b"tun0"
DEVICE_QUEUE = 10_000  # packets: a busy machine's emulator may be late, its devices must not drop meanwhile
NETMASK = "255.255.255.0"
END_WITHIN_S = 10.0

_libc = ctypes.CDLL(None, use_errno=True)


class Namespace:
    """One end: a network namespace whose only way out is a TUN device."""

    def __init__(self, address: str) -> None:
        """Raises OSError where this process may not make one."""
        self.address = address
        # In a thread of its own: a thread that has changed its namespace is good for nothing else.
        self._fd, self.tun_fd = in_thread(lambda: _make_namespace(address))

    def command(self, *arguments: str) -> list[str]:
        """The command that runs a program in here, as the same process."""
        return ["nsenter", f"--net=/proc/{os.getpid()}/fd/{self._fd}", *arguments]

    @contextmanager
    def entered(self) -> Iterator[None]:
        """This thread is in here meanwhile; do not await inside: other tasks would be in here too."""
        with open(OWN_NAMESPACE) as outside:
            _check(_libc.setns(self._fd, CLONE_NEWNET), "enter the network namespace")
            try:
                yield
            finally:
                _check(_libc.setns(outside.fileno(), CLONE_NEWNET), "leave the network namespace")

    def close(self) -> None:
        os.close(self.tun_fd)
        os.close(self._fd)


class Network:
    """The robot's and the station's namespace, and the process that carries packets between them."""

    def __init__(self, conditions: Conditions, seed: int = 0) -> None:
        self.robot = Namespace("10.19.0.1")
        self.station = Namespace("10.19.0.2")
        fds = (self.robot.tun_fd, self.station.tun_fd)
        options = [*map(str, fds), str(seed), json.dumps(asdict(conditions))]
        self._carrier = subprocess.Popen(
            [sys.executable, "-m", "tests.support.network.carrier", *options],
            cwd=ROOT,
            pass_fds=fds,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        self.counts()  # it runs

    @property
    def pid(self) -> int:
        """Of the process that carries."""
        return self._carrier.pid

    def use(self, conditions: Conditions) -> None:
        """Other conditions, from now on; what is on its way arrives as it would have."""
        self._ask(asdict(conditions))

    def counts(self) -> dict[str, Counts]:
        """What became of the packets so far: "to_robot" and "to_station"."""
        return {name: Counts(**counts) for name, counts in self._ask({}).items()}

    def close(self) -> None:
        self._carrier.communicate(timeout=END_WITHIN_S)
        self.robot.close()
        self.station.close()

    def __enter__(self) -> Network:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _ask(self, line: dict[str, Any]) -> dict[str, dict[str, Any]]:
        assert self._carrier.stdin is not None and self._carrier.stdout is not None
        self._carrier.stdin.write(json.dumps(line).encode() + b"\n")
        self._carrier.stdin.flush()
        answer: dict[str, dict[str, Any]] = json.loads(self._carrier.stdout.readline())
        return answer


def missing_reason() -> str | None:
    """Why there can be no emulated network here; None where there can."""
    try:
        Namespace("10.19.0.1").close()
    except OSError as exc:
        return f"no emulated network: {exc}; it needs root, network namespaces and /dev/net/tun"
    return None


def in_thread(work: Callable[[], T]) -> T:
    """What `work` returns or raises, run in a thread that then ends."""
    outcome: list[T] = []
    failure: list[OSError] = []

    def run() -> None:
        try:
            outcome.append(work())
        except OSError as exc:
            failure.append(exc)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    if failure:
        raise failure[0]
    return outcome[0]


def _make_namespace(address: str) -> tuple[int, int]:
    """Returns (namespace, TUN device), both as open files."""
    _check(_libc.unshare(CLONE_NEWNET), "make a network namespace")
    tun_fd = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    fcntl.ioctl(tun_fd, TUNSETIFF, struct.pack("16sH22x", DEVICE, IFF_TUN | IFF_NO_PI))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        fcntl.ioctl(control, SIOCSIFTXQLEN, struct.pack("16si20x", DEVICE, DEVICE_QUEUE))
        for request, value in ((SIOCSIFADDR, address), (SIOCSIFNETMASK, NETMASK)):
            packed = struct.pack("16sHH4s16x", DEVICE, socket.AF_INET, 0, socket.inet_aton(value))
            fcntl.ioctl(control, request, packed)
        for name in (DEVICE, b"lo"):
            flags = struct.unpack("16xH22x", fcntl.ioctl(control, SIOCGIFFLAGS, struct.pack("16s24x", name)))[0]
            fcntl.ioctl(control, SIOCSIFFLAGS, struct.pack("16sH22x", name, flags | IFF_UP))
    return os.open(OWN_NAMESPACE, os.O_RDONLY | os.O_CLOEXEC), tun_fd


def _check(result: int, what: str) -> None:
    if result != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"{os.strerror(number)} ({what})")
