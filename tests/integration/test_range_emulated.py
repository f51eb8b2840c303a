"""The HC-SR04 at the real firmware in the emulated board: what it measures, and that it holds up nothing else."""

import random
from itertools import pairwise
from pathlib import Path

import pytest

from shared import serial_protocol as sp
from tests.support.emulator import board
from tests.support.stopping.firmware import FAULTS, run

pytestmark = pytest.mark.skipif(board.missing_reason() is not None, reason=board.missing_reason() or "")

INTERRUPTS_OFF_US = 40  # as without it (test_firmware_emulated.py)
LOOP_US = 2000
OFTEN = (0.5, board.uart(sp.ConfigRange(50)))  # the shortest period
STATES = ["echo 5831", "echo 0", "mute", "stuck", "unplug", "rings"]


@pytest.fixture(scope="module", autouse=True)
def built() -> None:
    board.build()


def ranges(run: board.Run) -> list[sp.RangePacket]:
    return [m for m in run.messages() if isinstance(m, sp.RangePacket)]


def assert_no_sample_is_lost(run: board.Run) -> None:
    numbers = [p.sequence for p in run.imu()]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    last = run.statuses()[-1]
    assert (last.samples_lost, last.rx_bad, last.rx_overruns) == (0, 0, 0)


@pytest.mark.parametrize("echo_us", [116, 5831, 11_662, 23_324])  # 2 cm, 1 m, 2 m, 4 m
def test_an_echo_is_measured_to_two_microseconds_whatever_else_goes_on(tmp_path: Path, echo_us: int) -> None:
    """0.3 mm. The timer notes the edges; drive commands, ramps and the IMU's interrupts only make us read it later."""
    drives = [d for i in range(20) for d in board.drive([1.0 + 0.1 * i], 900 - 300 * (i % 7), 300 * (i % 7) - 850)]
    script = [(0.4, f"range echo {echo_us}"), (0.5, board.uart(sp.ConfigRange(100))), *drives]
    done = board.batch(tmp_path, 3.5, script)
    found = ranges(done)
    assert len(found) == pytest.approx(30, abs=1)
    assert [p.sequence for p in found] == list(range(len(found)))
    assert {p.echo for p in found} == {sp.Echo.HEARD}
    assert max(abs(p.echo_us - echo_us) for p in found) <= 2
    assert {b.t_us - a.t_us for a, b in pairwise(found)} <= set(range(98_900, 101_100))  # the loop's millisecond
    assert_no_sample_is_lost(done)


def test_a_firmware_that_nobody_asks_for_it_sends_what_older_ones_sent(tmp_path: Path) -> None:
    """A robot-server from before takes it as it is; so does one whose robot has no such sensor."""
    done = board.batch(tmp_path, 2.0, [(0.4, "range echo 5831"), *board.drive([1.0, 1.1], 400, 400)])
    kinds = {payload[0] for payload in sp.SerialDecoder().receive(done.stream)}
    assert kinds <= {sp.Type.HELLO, sp.Type.IMU, sp.Type.STATUS, sp.Type.ACK}
    assert done.facts["measurements"] == 0
    hello = next(m for m in done.messages() if isinstance(m, sp.Hello))
    assert (hello.version, hello.firmware_major, hello.firmware_minor) == (2, 2, 1)


def test_nothing_in_reach_is_no_missing_sensor(tmp_path: Path) -> None:
    done = board.batch(tmp_path, 2.5, [(0.4, "range echo 0"), OFTEN, (1.5, "range copy 200000")])
    assert {p.echo for p in ranges(done)} == {sp.Echo.NONE}
    copies = [p for p in ranges(done) if p.t_us > 1.6e6]
    assert 3 <= len(copies) <= 5  # each waits until ECHO has fallen


@pytest.mark.parametrize("state", ["mute", "stuck", "unplug", "rings"])
def test_a_sensor_that_does_not_work_is_told_and_taken_again_when_it_does(tmp_path: Path, state: str) -> None:
    script = [(0.4, f"range {state}"), OFTEN, (2.0, "range echo 5831")]
    done = board.batch(tmp_path, 3.0, script)
    broken = [p for p in ranges(done) if p.t_us < 2.0e6]
    assert len(broken) >= 3 and {p.echo for p in broken} == {sp.Echo.SILENT}
    later = [p for p in ranges(done) if p.t_us > 2.5e6]
    assert {p.echo for p in later} == {sp.Echo.HEARD} and len(later) >= 9
    assert_no_sample_is_lost(done)


def test_a_period_of_zero_ends_the_measurements_and_one_out_of_range_is_refused(tmp_path: Path) -> None:
    off, bad = board.uart(sp.ConfigRange(0)), board.uart(sp.ConfigRange(49))
    done = board.batch(tmp_path, 2.0, [(0.4, "range echo 5831"), (0.45, bad), OFTEN, (1.0, off)])
    results = [m.result for m in done.messages() if isinstance(m, sp.Ack) and m.asked == sp.Type.CONFIG_RANGE]
    assert results == [2, 0, 0]
    assert ranges(done) and max(p.t_us for p in ranges(done)) < 1.05e6


def busy(state: str | None) -> list[tuple[float, str]]:
    """A second of driving, at its end nothing more; beside it a range sensor in some state, or none."""
    sensor = [] if state is None else [(0.4, f"range {state}"), OFTEN]
    return [*sensor, *board.drive([1.0 + 0.05 * i for i in range(20)], 900, -700, 300)]


@pytest.fixture(scope="module")
def without(tmp_path_factory: pytest.TempPathFactory) -> board.Run:
    return board.batch(tmp_path_factory.mktemp("without"), 3.0, busy(None))


@pytest.mark.parametrize("state", STATES)
def test_motors_stop_when_they_would_without_it(tmp_path: Path, state: str, without: board.Run) -> None:
    """To the millisecond of the emulator's windows: the motors' tick is an interrupt that this never masks for long."""
    done = board.batch(tmp_path, 3.0, busy(state))
    assert abs(done.stopped_after(1.95e6) - without.stopped_after(1.95e6)) <= 1000
    assert done.statuses()[-1].ttl_stops == without.statuses()[-1].ttl_stops == 1


@pytest.mark.parametrize("state", STATES)
def test_neither_the_loop_nor_the_interrupts_wait_for_it(tmp_path: Path, state: str, without: board.Run) -> None:
    done = board.batch(tmp_path, 3.0, [(0.6, "interrupts_off"), *busy(state)])
    assert 0 < done.facts["interrupts_off_us"] <= INTERRUPTS_OFF_US
    worst, before = (max(s.loop_max_us for s in r.statuses() if s.uptime_ms > 800) for r in (done, without))
    assert worst <= min(before + 400, LOOP_US), (worst, before)
    assert_no_sample_is_lost(done)
    assert not any("trig too short" in text for _, text in done.events)


def test_a_flood_costs_answers_and_no_measurement(tmp_path: Path) -> None:
    flood = "uart " + sp.encode(sp.AskTime(1)).hex() * 40
    done = board.batch(
        tmp_path, 3.0, [(0.4, "range echo 2900"), OFTEN, *[(1.1 + 0.015 * i, flood) for i in range(100)]]
    )
    found = ranges(done)
    assert [p.sequence for p in found] == list(range(len(found))) and len(found) >= 49
    assert_no_sample_is_lost(done)
    assert done.statuses()[-1].tx_dropped > 0
    assert {round(b.uptime_ms - a.uptime_ms, -1) for a, b in pairwise(done.statuses())} == {100}


def test_a_run_with_it_repeats_bit_for_bit(tmp_path: Path) -> None:
    first, second = (board.batch(tmp_path / name, 2.0, busy("echo 5831")) for name in ("first", "second"))
    assert first.stream == second.stream and first.pins == second.pins


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_of_the_stop_bench_stops_the_motors_in_time_with_a_wire_that_rings(fault: str) -> None:
    beside = [(0.4, "range rings"), OFTEN]
    judged = list(run(fault, 2, random.Random(1), beside))
    assert len(judged) == 2 and all(one.pins_ms is not None and one.is_good for one in judged), judged
