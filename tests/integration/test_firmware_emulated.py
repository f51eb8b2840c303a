"""The real firmware binary in the emulated board. Only the MCU's time is judged, never the PC's."""

import random
import subprocess
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path

import pytest

from shared import serial_protocol as sp
from tests.support.emulator import board
from tests.support.imu_packets import mag_imu
from tests.support.paths import ROOT
from tests.support.stopping.firmware import FAULTS, run

pytestmark = pytest.mark.skipif(board.missing_reason() is not None, reason=board.missing_reason() or "")

FIRMWARE_BOUND_US = 500_000  # from the fault to zero duty at the pins
INTERRUPTS_OFF_US = 40
STAMP_LATE_US = 3
LOADER_S = 0.83  # the stock bootloader's stay
DUTY_ERROR = 8  # permille: the emulator moves a PWM edge by a few of a period's 800 cycles


@pytest.fixture(scope="module", autouse=True)
def built() -> None:
    board.build()


def assert_lossless(packets: list[sp.ImuPacket]) -> None:
    """Every number once, and the bytes of a sample belong to one sample."""
    numbers = [p.sequence for p in packets]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    for packet in packets:
        ax, ay, az, gx, gy, gz, _ = packet.raw()
        n = ax & 0xFFFF
        assert [ay & 0xFFFF, az & 0xFFFF] == [n * 2 & 0xFFFF, n * 3 & 0xFFFF]
        assert [gx & 0xFFFF, gy & 0xFFFF, gz & 0xFFFF] == [n * 5 & 0xFFFF, n * 6 & 0xFFFF, n * 7 & 0xFFFF]


def test_a_minute_at_225_hz_loses_nothing_and_repeats_bit_for_bit(tmp_path: Path) -> None:
    script = board.drive([2 + 0.05 * i for i in range(1000)], 400, -250)
    with ThreadPoolExecutor(2) as pool:
        first, second = pool.map(lambda name: board.batch(tmp_path / name, 60.5, script), ["first", "second"])
    assert first.stream == second.stream
    assert first.pins == second.pins
    decoder = sp.SerialDecoder()
    decoder.receive(first.stream)
    assert decoder.bad == 0
    packets = first.imu()
    assert_lossless(packets)
    assert len(packets) > 60 * 225
    rate_hz = (len(packets) - 1) / ((packets[-1].t_us - packets[0].t_us) * 1e-6)
    assert rate_hz == pytest.approx(225.0, abs=0.05)
    last = first.statuses()[-1]
    assert (last.samples_lost, last.tx_dropped, last.rx_bad, last.rx_overruns) == (0, 0, 0, 0)
    assert max(s.loop_max_us for s in first.statuses()) < 2000
    assert first.facts["stack_free"] > 4096
    # The magnetometer measures at 100 Hz beside it.
    fields = [m for p in packets if (m := mag_imu(p)) is not None]
    assert len(fields) == pytest.approx(100 * len(packets) / 225, rel=0.02)
    assert fields[-1] == pytest.approx((20.0, 0.0, -40.0), abs=0.16)


def test_motors_follow_commands_and_stop_when_they_go_silent(tmp_path: Path) -> None:
    script = board.drive([1.0, 1.1, 1.2, 1.3, 1.4], 600, -300, ttl_ms=300)
    run = board.batch(tmp_path, 3, script)
    assert run.duty_at(0.999e6) == (0, 0)
    left, right = run.duty_at(1.45e6)
    assert left == pytest.approx(600, abs=DUTY_ERROR) and right == pytest.approx(-300, abs=DUTY_ERROR)
    assert 295e3 <= run.stopped_after(1.4e6) <= 305e3
    assert run.statuses()[-1].flags & sp.Flag.TTL_STOP
    assert run.statuses()[-1].ttl_stops == 1


def test_a_stop_command_stops_within_milliseconds(tmp_path: Path) -> None:
    run = board.batch(tmp_path, 2, [*board.drive([1.0], 1000, 1000, 400), (1.35, board.uart(sp.Stop()))])
    assert run.duty_at(1.349e6) == (1000, 1000)
    assert run.stopped_after(1.35e6) <= 5e3


def late(seconds: list[float], by_ms: int) -> list[tuple[float, str]]:
    """Drive commands that come so much after their end, as a process does that was stopped before it wrote them."""
    return board.drive(seconds, 900, 900, -by_ms)


@pytest.mark.parametrize("by_ms", [10, 2000, 30_000, -2000])
def test_what_comes_after_its_end_starts_nothing_however_often_it_comes(tmp_path: Path, by_ms: int) -> None:
    """Nor what ends further ahead than any command does: its clock is not ours."""
    run = board.batch(tmp_path, 3, late([1.0 + 0.05 * i for i in range(20)], by_ms))
    assert all((left, right) == (0, 0) for _, left, right in run.pins)
    refusals = [m for m in run.messages() if isinstance(m, sp.Ack) and m.asked == sp.Type.DRIVE]
    assert [m.result for m in refusals] == [4] * 20


def test_what_comes_after_its_end_does_not_keep_motors_running(tmp_path: Path) -> None:
    good = board.drive([1.0, 1.1, 1.2, 1.3, 1.4], 600, 600, ttl_ms=250)
    run = board.batch(tmp_path, 3, [*good, *late([1.45 + 0.05 * i for i in range(20)], 10)])
    assert 245e3 <= run.stopped_after(1.4e6) <= 255e3


def test_a_command_that_took_its_time_on_the_line_ends_when_it_would_have(tmp_path: Path) -> None:
    run = board.batch(tmp_path, 3, board.drive([1.0], 600, 600, ttl_ms=100))
    assert 95e3 <= run.stopped_after(1.0e6) <= 110e3
    held_up = [(1.2, line) for _, line in board.drive([1.0], 600, 600, ttl_ms=300)]
    run = board.batch(tmp_path, 3, held_up)
    assert run.duty_at(1.29e6)[0] > 0
    assert 95e3 <= run.stopped_after(1.2e6) <= 110e3


def test_commands_of_the_time_before_a_reset_move_nothing_after_it(tmp_path: Path) -> None:
    """Not even where they end in time by the clock that began anew."""
    script = [*board.drive([1.0], 900, 900), (1.2, "reset"), *board.drive([2.3, 2.4], 900, 900, booted_s=1.2)]
    run = board.batch(tmp_path, 4, [*script, *board.drive([3.0], 900, 900, boot_id=2, booted_s=1.2)])
    assert all((left, right) == (0, 0) for t, left, right in run.pins if 1.21e6 < t < 2.99e6)
    assert run.duty_at(3.2e6)[0] > 500


@pytest.mark.parametrize("interrupts", ["on", "off"])
def test_a_hung_firmware_is_reset_into_motors_off(tmp_path: Path, interrupts: str) -> None:
    script = [*board.drive([1.0, 1.2], 800, 800, 400), (1.3, f"hang {interrupts}")]
    run = board.batch(tmp_path, 3, script)
    assert run.duty_at(1.3e6)[0] > 700
    assert run.stopped_after(1.3e6) <= FIRMWARE_BOUND_US
    assert any(text == "reset 1" for _, text in run.events)
    # And it comes back whole, without moving by itself.
    assert len({m.boot_id for m in run.messages() if isinstance(m, sp.Hello)}) == 2
    assert run.imu()[-1].sequence > 200


def test_no_motion_before_the_first_fresh_command_and_none_after_a_reset(tmp_path: Path) -> None:
    run = board.batch(tmp_path, 2.5, [*board.drive([1.0], 900, 900, 400), (1.2, "reset")])
    assert run.duty_at(0.9e6) == (0, 0)
    assert run.stopped_after(1.2e6) <= 3e3


def test_imu_unplugged_and_back(tmp_path: Path) -> None:
    run = board.batch(tmp_path, 5, [(2.0, "imu_unplug"), (3.0, "imu_plug")])
    statuses = run.statuses()
    assert any(s.flags & sp.Flag.IMU_MISSING for s in statuses if 2500 < s.uptime_ms < 3000)
    assert not statuses[-1].flags & sp.Flag.IMU_MISSING
    assert statuses[-1].imu_starts == 2
    packets = run.imu()
    gap_us = max(b.t_us - a.t_us for a, b in pairwise(packets))
    assert 1.0e6 < gap_us < 1.6e6  # it is back within 0.6 s of being plugged in
    assert packets[-1].t_us > 4.9e6


def test_imu_at_the_other_address_and_without_magnetometer(tmp_path: Path) -> None:
    run = board.batch(tmp_path, 1.5, [(0, "imu_address 68"), (0, "mag_present 0"), (1.2, board.uart(sp.AskHello()))])
    hello = [m for m in run.messages() if isinstance(m, sp.Hello)][-1]
    assert (hello.imu_address, hello.imu_who) == (0x68, 0xEA)
    assert run.statuses()[-1].flags == sp.Flag.MAG_MISSING
    assert_lossless(run.imu())


@pytest.mark.parametrize("pulses", [3, 9])
def test_a_stuck_bus_is_clocked_free(tmp_path: Path, pulses: int) -> None:
    run = board.batch(tmp_path, 3, [(1.5, f"bus_stuck {pulses}")])
    assert run.statuses()[-1].bus_recoveries >= 1
    packets = run.imu()
    gap_us = max(b.t_us - a.t_us for a, b in pairwise(packets))
    assert gap_us < 0.5e6
    assert packets[-1].t_us > 2.9e6


def test_a_bus_that_stays_stuck_is_reported_and_motors_still_obey(tmp_path: Path) -> None:
    drives = board.drive([1.6 + 0.1 * i for i in range(10)], 500, 500)
    run = board.batch(tmp_path, 4.5, [(1.5, "bus_stuck -1"), (3.0, "bus_stuck 0"), *drives])
    stuck = [s for s in run.statuses() if 2000 < s.uptime_ms < 3000]
    assert all(s.flags & sp.Flag.IMU_MISSING and s.flags & sp.Flag.BUS_ERROR for s in stuck)
    assert max(s.loop_max_us for s in stuck) < 2000
    assert run.duty_at(2.4e6)[0] == pytest.approx(500, abs=DUTY_ERROR)
    assert run.stopped_after(2.5e6) <= 255e3
    assert run.imu()[-1].t_us > 4.4e6


def test_corrupted_bytes_cost_frames_but_never_give_wrong_ones(tmp_path: Path) -> None:
    drives = board.drive([1.0 + 0.02 * i for i in range(100)], 300, 300)
    run = board.batch(tmp_path, 4, [(1.0, "corrupt 0.01"), (3.0, "corrupt 0"), *drives])
    decoder = sp.SerialDecoder()
    decoder.receive(run.stream)
    assert decoder.bad > 50
    assert run.statuses()[-1].rx_bad > 5
    for packet in run.imu():
        x, y = packet.raw()[0:2]
        assert y & 0xFFFF == x * 2 & 0xFFFF
    # While a ramp changes the compare registers every millisecond, the emulator lengthens pulses by up to 30 permille.
    assert all(left <= 330 and right <= 330 for _, left, right in run.pins)
    after = [p.sequence for p in run.imu() if p.t_us > 3.1e6]
    assert after == list(range(after[0], after[0] + len(after)))


def test_attaching_mid_stream_finds_the_next_frame(tmp_path: Path) -> None:
    run = board.batch(tmp_path, 1.5)
    whole = run.messages()
    rng = random.Random(5)
    for _ in range(200):
        start = rng.randrange(len(run.stream) - 200)
        late = run.messages(run.stream[start:])
        lost_bytes = run.stream.index(0, start) - start
        assert lost_bytes <= sp.MAX_FRAME
        assert late == whole[-len(late) :]
        assert len(late) > 0


def test_the_microsecond_counter_wraps_without_a_jump(tmp_path: Path) -> None:
    # Half a second before 2^32 us (71.6 minutes): the overflow counter has 17 bits that matter.
    overflows = (2**32 - 500_000) >> 15
    poke = f"poke {board.symbol('clock_overflows'):x} {overflows.to_bytes(4, 'little').hex()}"
    run = board.batch(tmp_path, 3, [(1.0, poke)])
    packets = run.imu()
    wraps = [i for i, (a, b) in enumerate(pairwise(packets)) if b.t_us < a.t_us]
    assert len(wraps) == 1
    steps = [(b.t_us - a.t_us) % 2**32 for a, b in pairwise(packets[300:])]
    # Where its interrupt meets the few instructions of the loop that hold interrupts off, a stamp is late by these.
    assert min(steps) >= 4444 - STAMP_LATE_US and max(steps) <= 4445 + STAMP_LATE_US
    assert sum(step in (4444, 4445) for step in steps) >= 0.9 * len(steps)
    assert_lossless(packets)


def test_full_scale_filter_and_rate_are_commandable(tmp_path: Path) -> None:
    config = sp.ConfigImu(gyro_scale=3, accel_scale=0, gyro_filter=2, accel_filter=2, divider=10)
    refused = sp.ConfigImu(divider=0)
    run = board.batch(
        tmp_path, 3, [(1.0, board.uart(config)), (2.9, board.uart(refused)), (2.95, board.uart(sp.AskHello()))]
    )
    acks = [m for m in run.messages() if isinstance(m, sp.Ack)]
    assert [(a.asked, a.result) for a in acks] == [(sp.Type.CONFIG_IMU, 0), (sp.Type.CONFIG_IMU, 2)]
    hello = [m for m in run.messages() if isinstance(m, sp.Hello)][-1]
    assert (hello.gyro_scale, hello.accel_scale, hello.divider) == (3, 0, 10)
    late = [p for p in run.imu() if p.t_us > 1.5e6]
    assert {p.scales for p in late} == {0x03}
    assert (len(late) - 1) / ((late[-1].t_us - late[0].t_us) * 1e-6) == pytest.approx(1125 / 11, abs=0.1)


def test_low_battery_holds_the_motors_off(tmp_path: Path) -> None:
    drives = board.drive([1.0 + 0.1 * i for i in range(40)], 500, 500)
    config = (0.5, board.uart(sp.ConfigMotors(cutoff_mv=6400)))
    run = board.batch(tmp_path, 5.5, [config, (1.5, "battery 6000"), *drives])
    assert run.duty_at(3.4e6)[0] == pytest.approx(
        500, abs=DUTY_ERROR
    )  # a dip shorter than two seconds is a motor starting
    assert run.duty_at(3.7e6) == (0, 0)
    assert run.statuses()[-1].flags & sp.Flag.LOW_BATTERY
    assert run.statuses()[-1].battery_mv == pytest.approx(6000, abs=30)


def test_a_fault_of_the_motor_driver_is_told_and_a_reset_makes_none(tmp_path: Path) -> None:
    drives = board.drive([1.0 + 0.1 * i for i in range(8)], 500, 500, boot_id=2, booted_s=0.3)
    run = board.batch(tmp_path, 2.2, [(0.3, "reset"), (1.5, "driver_fault 1"), *drives])
    faulty = [s.uptime_ms for s in run.statuses() if s.flags & sp.Flag.DRIVER_FAULT]
    assert faulty and min(faulty) >= 1200


def test_fast_decay_gives_the_same_duty(tmp_path: Path) -> None:
    drives = board.drive([1.0 + 0.1 * i for i in range(8)], -700, 450)
    run = board.batch(tmp_path, 2.5, [(0.5, board.uart(sp.ConfigMotors(slow_decay=False))), *drives])
    left, right = run.duty_at(1.8e6)
    assert left == pytest.approx(-700, abs=DUTY_ERROR) and right == pytest.approx(450, abs=DUTY_ERROR)
    assert run.duty_at(2.4e6) == (0, 0)


@pytest.mark.parametrize("slow_decay", [True, False])
def test_the_smallest_and_largest_duties_reach_the_pins(tmp_path: Path, slow_decay: bool) -> None:
    """One permille is less than a count of the timer: it must not become a pin that stays high."""
    duties = [1, 2, 500, 998, 999, 1000]
    script = [(0.4, board.uart(sp.ConfigMotors(slow_decay, ramp_up=255, ramp_down=255)))]
    for i, duty in enumerate(duties):
        script += [*board.drive([0.5 + 0.2 * i], duty, -duty), (0.67 + 0.2 * i, board.uart(sp.Stop()))]  # from braking
    run = board.batch(tmp_path, 1.8, script)
    for i, duty in enumerate(duties):
        left, right = run.duty_at(0.65e6 + 0.2e6 * i)
        expected = duty * 800 // 1000 / 0.8
        assert left == pytest.approx(expected, abs=DUTY_ERROR) and right == pytest.approx(-expected, abs=DUTY_ERROR)


@pytest.mark.parametrize("slow_decay", [True, False])
def test_interrupts_are_never_off_for_longer_than_the_uart_can_wait(tmp_path: Path, slow_decay: bool) -> None:
    """At 500 kBd a byte takes 20 us and the AVR holds three; simavr's UART would hold 64 and show no loss."""
    drives = [d for i in range(10) for d in board.drive([1.0 + 0.2 * i], 900 - 300 * (i % 7), 300 * (i % 7) - 850)]
    config = (0.8, board.uart(sp.ConfigMotors(slow_decay, ramp_up=7, ramp_down=3, cutoff_mv=6400)))
    run = board.batch(tmp_path, 3.5, [(0.7, "interrupts_off"), config, *drives, (2.9, board.uart(sp.Stop()))])
    assert any(0 < left < 900 for _, left, _ in run.pins)
    assert 0 < run.facts["interrupts_off_us"] <= INTERRUPTS_OFF_US


def test_servo_pulses_have_the_commanded_width(tmp_path: Path) -> None:
    run = board.batch(tmp_path, 1.5, [(1.0, board.uart(sp.Servo(1500, 2000)))])
    assert ("servo 0 1500" in [t for _, t in run.events]) and ("servo 1 2000" in [t for _, t in run.events])


def test_a_flood_of_frames_neither_loses_imu_samples_nor_keeps_motors_running(tmp_path: Path) -> None:
    flood = "uart " + sp.encode(sp.AskTime(1)).hex() * 40
    drives = board.drive([1.0, 1.1], 500, 500)
    run = board.batch(tmp_path, 3, [*drives, *[(1.1 + 0.015 * i, flood) for i in range(100)]])
    assert run.stopped_after(1.1e6) <= FIRMWARE_BOUND_US
    assert_lossless(run.imu())
    assert run.imu()[-1].t_us > 2.9e6
    last = run.statuses()[-1]
    assert last.samples_lost == 0
    assert last.tx_dropped > 0  # answers: more of them than the line takes
    assert {round(b.uptime_ms - a.uptime_ms, -1) for a, b in pairwise(run.statuses())} == {100}


def test_samples_lost_are_the_holes_in_the_numbers(tmp_path: Path) -> None:
    script = [(1.0, "imu_unplug"), (1.4, "imu_plug"), (2.2, "bus_stuck 3"), (3.0, board.uart(sp.ConfigImu(divider=10)))]
    run = board.batch(tmp_path, 4.5, script)
    holes = [b.sequence - a.sequence - 1 for a, b in pairwise(run.imu())]
    assert sum(holes) == run.statuses()[-1].samples_lost > 0
    # A set-up anew shows as one at least, so that nobody takes what it bridges for one step.
    assert sum(hole > 0 for hole in holes) >= run.statuses()[-1].imu_starts - 1 >= 2
    long_steps = [hole for hole, (a, b) in zip(holes, pairwise(run.imu()), strict=True) if b.t_us - a.t_us > 12_000]
    assert len(long_steps) >= 2 and min(long_steps) > 0


def test_hello_comes_unasked_until_the_pi_speaks(tmp_path: Path) -> None:
    run = board.batch(tmp_path, 4.2, [(2.5, board.uart(sp.AskTime(1)))])
    kinds = [type(m) for m in run.messages() if isinstance(m, sp.Hello | sp.MegaTime)]
    assert kinds == [sp.Hello] * 3 + [sp.MegaTime]


@pytest.mark.skipif(not board.BOOTLOADER.is_file(), reason="Debian's arduino-core-avr has the Mega's bootloader")
def test_with_the_stock_bootloader_a_silent_pi_is_greeted_and_a_hang_is_told(tmp_path: Path) -> None:
    """The Pi listens for 2.5 s after opening (which resets the Mega) before it writes: the hello comes within them."""
    greeting = [(2.5, board.uart(sp.AskHello())), *board.drive([2.6, 2.8], 500, 500, 400, booted_s=LOADER_S)]
    run = board.batch(tmp_path, 4.2, [*greeting, (2.9, "hang on")], boot=board.BOOTLOADER)
    hellos = [m for m in run.messages() if isinstance(m, sp.Hello)]
    assert len(hellos) >= 4  # two unasked, the answer, and after the hang
    assert hellos[0].boot_id == hellos[2].boot_id != hellos[-1].boot_id
    assert hellos[0].reset_cause == 0 and hellos[-1].reset_cause == 8  # this bootloader clears MCUSR
    assert run.duty_at(2.9e6)[0] == pytest.approx(500, abs=DUTY_ERROR)
    assert run.stopped_after(2.9e6) <= FIRMWARE_BOUND_US


def test_the_dmp_option_compiles(tmp_path: Path) -> None:
    """Against declarations only: the library that brings the vendor's image is not ours to ship."""
    stand_in = ROOT / "tests" / "support" / "emulator" / "dmp_stand_in"
    targets = [str(tmp_path / "sentinel" / name) for name in ("sentinel.ino.o", "dmp.o", "twi_bus.o")]
    run = subprocess.run(
        ["make", "-s", "-C", str(board.ROOT / "firmware"), f"DMP={stand_in}", f"BUILD={tmp_path}", *targets],
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stdout + run.stderr


def test_firmware_stays_small() -> None:

    text, data, bss = map(
        int,
        subprocess.run(["avr-size", board.ELF], capture_output=True, text=True, check=True)
        .stdout.splitlines()[1]
        .split()[:3],
    )
    assert text + data <= 0.25 * 253_952
    assert data + bss <= 0.40 * 8_192


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_of_the_stop_bench_is_judged_and_stops_the_motors_in_time(fault: str) -> None:
    judged = list(run(fault, 2, random.Random(1)))
    assert len(judged) == 2 and all(one.pins_ms is not None and one.is_good for one in judged), judged
