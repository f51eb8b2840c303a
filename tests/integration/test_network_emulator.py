"""The emulated network under real TCP and UDP: is it what was asked? A busy machine only makes things later."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace

import psutil
import pytest

from robot.parity import Losses
from shared.datagrams import Opener, Sealer
from shared.picture_pieces import Assembler, cut, num_pieces
from tests.support.network.conditions import PROFILES, Conditions
from tests.support.network.emulator import Network, missing_reason
from tests.support.paths import ROOT

MISSING = missing_reason()
pytestmark = pytest.mark.skipif(MISSING is not None, reason=MISSING or "")

PORT = 7400
WAIT_S = 90.0
SO_RCVBUFFORCE = 33  # asm-generic/socket.h; Python has no name for it


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, "the awaited condition did not come true"
        time.sleep(0.01)


def udp_pair(network: Network) -> tuple[socket.socket, socket.socket]:
    """(robot's, connected to the station's; station's, connected to the robot's)."""
    with network.robot.entered():
        robot = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with network.station.entered():
        station = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    robot.bind((network.robot.address, PORT))
    station.bind((network.station.address, PORT))
    robot.connect(station.getsockname())
    station.connect(robot.getsockname())
    for end in (robot, station):
        end.settimeout(WAIT_S)
        end.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 1 << 24)  # so that the receiver drops none
    return robot, station


def tcp_pair(network: Network) -> tuple[socket.socket, socket.socket]:
    """The robot's end and the station's of a connection."""
    with network.robot.entered():
        listener = socket.create_server((network.robot.address, PORT))
    with network.station.entered():
        station = socket.create_connection((network.robot.address, PORT), timeout=WAIT_S)
    robot, _ = listener.accept()
    listener.close()
    robot.settimeout(WAIT_S)
    return robot, station


def numbers_that_arrive(conditions: Conditions, seed: int, count: int) -> list[int]:
    """Which of `count` datagrams arrive, in the order of arrival."""
    with Network(conditions, seed) as network:
        robot, station = udp_pair(network)
        with robot, station:
            for n in range(count):
                robot.send(n.to_bytes(4, "big"))

            def all_are_judged() -> bool:
                counts = network.counts()["to_station"]
                return counts.delivered + counts.lost == count

            until(all_are_judged)
            return [int.from_bytes(station.recv(4), "big") for _ in range(network.counts()["to_station"].delivered)]


def test_network_without_conditions_loses_and_reorders_nothing() -> None:
    assert numbers_that_arrive(Conditions(), 1, 2000) == list(range(2000))


def test_share_of_lost_datagrams_is_what_was_asked_and_the_same_for_the_same_seed() -> None:
    arrived = numbers_that_arrive(Conditions(loss=0.1), 1, 2000)
    assert 0.07 < 1 - len(arrived) / 2000 < 0.13
    assert numbers_that_arrive(Conditions(loss=0.1), 1, 2000) == arrived
    assert numbers_that_arrive(Conditions(loss=0.1), 2, 2000) != arrived


def test_some_datagrams_overtake_others_when_asked() -> None:
    arrived = numbers_that_arrive(Conditions(reordered=0.1, reordered_by_ms=5), 1, 2000)
    assert arrived != sorted(arrived) and sorted(arrived) == list(range(2000))


def test_quickest_round_trip_is_twice_the_delay() -> None:
    with Network(Conditions(delay_ms=25)) as network:
        robot, station = udp_pair(network)
        with robot, station:
            round_trips_ms = []
            for _ in range(20):
                begin_ns = time.monotonic_ns()
                station.send(b"ping")
                robot.send(robot.recv(4))
                station.recv(4)
                round_trips_ms.append((time.monotonic_ns() - begin_ns) * 1e-6)
    assert 50 <= min(round_trips_ms) < 75


@pytest.mark.parametrize("rate_mbit_s", [2.0, 40.0])
def test_tcp_gets_the_bandwidth_that_was_asked_and_no_more(rate_mbit_s: float) -> None:
    size = round(rate_mbit_s * 1e6 / 8 * 2)  # two seconds' worth
    with Network(Conditions(rate_mbit_s=rate_mbit_s, delay_ms=3)) as network:
        robot, station = tcp_pair(network)
        with robot, station:
            sender = threading.Thread(target=robot.sendall, args=(bytes(size),))
            begin_s = time.monotonic()
            sender.start()
            received, best_mbit_s, window_s, window = 0, 0.0, begin_s, 0
            while received < size:
                num = len(station.recv(65536))
                received, window = received + num, window + num
                if (seconds := time.monotonic() - window_s) > 0.25:
                    # The best window: on a machine that stands still the others say nothing of the network.
                    best_mbit_s, window_s, window = max(best_mbit_s, window * 8e-6 / seconds), time.monotonic(), 0
            lasted_s = time.monotonic() - begin_s
            sender.join()
    assert size * 8e-6 / lasted_s <= rate_mbit_s
    assert best_mbit_s > 0.6 * rate_mbit_s


def test_full_queue_delays_as_long_as_was_asked_and_drops_the_rest() -> None:
    with Network(Conditions(rate_mbit_s=2, queue_ms=200)) as network:
        robot, station = udp_pair(network)
        with robot, station:
            begin_ns = time.monotonic_ns()
            for _ in range(200):  # 1.1 s worth
                robot.send(bytes(1400))
            until(lambda: network.counts()["to_station"].packets == 200)
            until(lambda: network.counts()["to_station"].delivered * 1428 * 8 / 2e6 >= 0.2)
            lasted_ms = (time.monotonic_ns() - begin_ns) * 1e-6
            counts = network.counts()["to_station"]
    assert counts.overflowed > 0
    assert lasted_ms >= 200


def test_tcp_brings_everything_through_losses_and_an_outage() -> None:
    content = os.urandom(300_000)
    conditions = replace(PROFILES["two walls"], rate_mbit_s=8)
    with Network(conditions, seed=3) as network:
        robot, station = tcp_pair(network)
        with robot, station:
            sender = threading.Thread(target=robot.sendall, args=(content,))
            sender.start()
            received = station.recv(65536)
            network.use(replace(conditions, loss=1.0))
            lost_before = network.counts()["to_station"].lost
            until(lambda: network.counts()["to_station"].lost >= lost_before + 3)
            network.use(conditions)
            while len(received) < len(content):
                received += station.recv(65536)
            sender.join()
    assert received == content


def test_nothing_passes_in_the_outages_of_a_roaming_robot() -> None:
    with Network(Conditions(outage_every_s=1.0, outage_s=0.5)) as network:
        robot, station = udp_pair(network)
        with robot, station:
            for _ in range(400):
                robot.send(b"x")
                time.sleep(0.005)
            until(lambda: network.counts()["to_station"].packets == 400)
            counts = network.counts()["to_station"]
    assert 0.2 < counts.in_outage / counts.packets < 0.8
    assert counts.delivered == counts.packets - counts.in_outage


def test_program_run_in_a_namespace_sees_that_network_alone() -> None:
    source = "import socket; print([name for _, name in socket.if_nameindex()])"
    with Network(Conditions()) as network:
        seen = subprocess.run(
            network.robot.command(sys.executable, "-c", source), capture_output=True, text=True, check=True
        )
        before = os.readlink("/proc/thread-self/ns/net")
        with network.station.entered():
            assert os.readlink("/proc/thread-self/ns/net") != before
        assert os.readlink("/proc/thread-self/ns/net") == before
    assert "tun0" in seen.stdout and "eth0" not in seen.stdout


def test_nothing_is_left_of_a_network_whose_process_was_killed() -> None:
    source = (
        "import time; from tests.support.network.emulator import *;"
        "network = Network(Conditions()); print(network.pid, flush=True); time.sleep(600)"
    )
    with subprocess.Popen([sys.executable, "-c", source], cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        carrier = psutil.Process(int(process.stdout.readline()))
        process.send_signal(signal.SIGKILL)
    until(lambda: not carrier.is_running() or carrier.status() == psutil.STATUS_ZOMBIE)


@pytest.mark.parametrize(("name", "least_share"), [("busy 2.4 GHz", 0.95), ("two walls", 0.95), ("bad", 0.9)])
def test_pictures_by_datagrams_survive_the_losses_of_a_network(name: str, least_share: float) -> None:
    """Counted, not timed: without bottleneck and jitter, by which a busy machine would lose some too."""
    key, picture = bytes(32), bytes(n % 251 for n in range(8000))
    sealer, opener, assembler, losses = Sealer(key, 1), Opener(key, 1), Assembler(), Losses()
    whole = unharmed = sent = received = 0
    with Network(replace(PROFILES[name], rate_mbit_s=0, delay_ms=0, jitter_ms=0), seed=1) as network:
        robot, station = udp_pair(network)
        with robot, station:
            for number in range(300):
                pieces = cut(picture, number, losses.parity(num_pieces(len(picture))))
                for piece in pieces:
                    robot.send(sealer.seal(piece))
                sent += len(pieces)
                until(lambda: sum_of_fates(network) == sent)  # noqa: B023
                came = network.counts()["to_station"].delivered - received
                received += came
                opened = [opener.open(station.recv(2000)) for _ in range(came)]
                whole += sum(assembler.add(piece, 0) == picture for piece in opened if piece is not None)
                unharmed += came == len(pieces)
                losses.note(len(pieces), len(pieces) - came)
    assert unharmed < whole and whole >= least_share * 300


def sum_of_fates(network: Network) -> int:
    """How many packets to the station have arrived or been lost."""
    counts = network.counts()["to_station"]
    return counts.delivered + counts.lost
