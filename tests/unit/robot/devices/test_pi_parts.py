"""The real robot's parts that think, without hardware: kinematics, exposure, the guard of GPIO motors, settings."""

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import msgspec
import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.config import PiConfig
from robot.devices.pi import adapter
from robot.devices.pi.exposure import TARGET, Exposure, ExposureControl
from robot.devices.pi.gpio_parts import GpioMotors, GpioProcess
from robot.devices.pi.gpio_pins import Guard
from robot.devices.pi.ina219 import Ina219Battery
from robot.devices.pi.kinematics import DriveGeometry
from robot.devices.ports import BatteryState
from shared.calibration import REFERENCE_ROBOT
from shared.errors import ConfigError, DataError, DeviceLost, DeviceUnavailable
from tests.support import mock_gpio, pi_stubs

speeds = st.floats(-2, 2)


@given(linear=speeds, angular=st.floats(-10, 10))
def test_duties_stay_within_full_and_turn_the_right_way(linear: float, angular: float) -> None:
    left, right = DriveGeometry().duties(linear, angular)
    assert abs(left) <= 1000 and abs(right) <= 1000
    if angular > 0.1:
        assert right > left
    if linear > 0.05 and abs(angular) < 0.01:
        assert left > 0 and right > 0


@given(linear=st.floats(-0.3, 0.3), angular=st.floats(-1, 1))
def test_velocity_is_the_inverse_of_duties(linear: float, angular: float) -> None:
    geometry = DriveGeometry(invert_left=True)
    back = geometry.velocity(*geometry.duties(linear, angular))
    assert back == pytest.approx((linear, angular), abs=0.01)


def test_standing_still_is_no_duty_at_all() -> None:
    assert DriveGeometry().duties(0.0, 0.0) == (0, 0)


@given(scene=st.floats(0.002, 0.5))
def test_exposure_reaches_the_target_or_its_limits_and_rests(scene: float) -> None:
    control, now = ExposureControl(10_000, 8.0), Exposure(1000, 1.0)
    for _ in range(30):
        brightness = min(255.0, scene * now.time_us * now.gain)
        wanted = control.next(now, brightness)
        if wanted is None:
            break
        now = wanted
    assert wanted is None
    assert 100 <= now.time_us <= 10_000 and 1.0 <= now.gain <= 8.0
    assert now.gain == 1.0 or now.time_us == 10_000  # time before gain
    brightness = min(255.0, scene * now.time_us * now.gain)
    is_at_limit = now == Exposure(10_000, 8.0) or now == Exposure(100, 1.0)
    assert is_at_limit or brightness == pytest.approx(TARGET, rel=0.18)


def soon_ns() -> int:
    return time.monotonic_ns() + 250_000_000


class RecordingPins:
    def __init__(self) -> None:
        self.history: list[tuple[int, int]] = []

    def drive(self, left: int, right: int) -> None:
        self.history.append((left, right))

    def stop(self) -> None:
        self.history.append((0, 0))

    def servo(self, pan_us: int, tilt_us: int) -> None: ...


def test_gpio_motors_stop_when_commands_go_silent() -> None:
    pins = RecordingPins()
    guard = Guard(pins)
    guard.line("drive 500 -500 10300", 10.0)
    assert guard.tick(10.2) == pytest.approx(0.1)
    assert guard.tick(10.3) is None
    assert pins.history == [(500, -500), (0, 0)]


@pytest.mark.parametrize("text", ["", "drive", "drive 1 2", "drive 1 2 99", "drive a b c", "fly 1 2 3", "servo 1"])
def test_gpio_motors_stop_at_a_line_they_do_not_understand(text: str) -> None:
    pins = RecordingPins()
    guard = Guard(pins)
    guard.line("drive 500 500 300", 0.0)
    guard.line(text, 0.1)
    assert pins.history[-1] == (0, 0) and guard.tick(0.1) is None


def test_a_line_that_waited_in_the_pipe_moves_nothing() -> None:
    pins = RecordingPins()
    guard = Guard(pins)
    guard.line("drive 500 500 10300", 10.3)
    assert set(pins.history) == {(0, 0)} and guard.tick(10.3) is None


def test_gpio_time_to_live_has_an_upper_bound() -> None:
    guard = Guard(RecordingPins())
    guard.line("drive 500 500 99999", 0.0)
    assert guard.tick(0.41) is None


GUARD_PROGRAM = """
import sys, time
from robot.devices.pi.gpio_pins import Guard, serve
class Pins:
    def drive(self, left, right): print("drive", left, right, file=sys.stderr, flush=True)
    def stop(self): print("stop", file=sys.stderr, flush=True)
    def servo(self, pan, tilt): pass
print("ready", flush=True)
serve(Guard(Pins()), sys.stdin.fileno())
"""


PARENT_PROGRAM = """
import subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", sys.argv[1]], stdin=subprocess.PIPE, stderr=open(sys.argv[2], "wb"))
child.stdin.write(b"drive 500 500 %d\\n" % (time.monotonic() * 1000 + 30_000))
child.stdin.flush()
time.sleep(60)
"""


def test_gpio_process_stops_the_motors_when_its_parent_is_killed(tmp_path: Path) -> None:
    log = tmp_path / "log"
    parent = subprocess.Popen([sys.executable, "-c", PARENT_PROGRAM, GUARD_PROGRAM, str(log)], stdout=subprocess.PIPE)
    deadline = time.monotonic() + 30
    while not (log.exists() and "drive" in log.read_text()):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    parent.kill()
    parent.communicate()
    while not log.read_text().rstrip().endswith("stop"):
        assert time.monotonic() < deadline
        time.sleep(0.01)


def wait_for_end(log: Path, word: str) -> None:
    deadline = time.monotonic() + 30
    while not log.read_text().rstrip().endswith(word):
        assert time.monotonic() < deadline, log.read_text()
        time.sleep(0.01)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGABRT])
def test_gpio_process_stops_the_motors_when_a_signal_ends_it(tmp_path: Path, number: signal.Signals) -> None:
    log = tmp_path / "log"
    with log.open("wb") as stderr:
        process = subprocess.Popen([sys.executable, "-c", GUARD_PROGRAM], stdin=subprocess.PIPE, stderr=stderr)
    assert process.stdin is not None
    until_ms = time.monotonic() * 1000 + 1e9
    # The guard holds no more than 400 ms: driven anew, so that it is surely driving when the signal comes.
    process.stdin.write(b"drive 500 500 %d\n" % until_ms)
    process.stdin.flush()
    wait_for_end(log, "drive 500 500")
    process.send_signal(number)
    assert process.wait(30) == 128 + number
    wait_for_end(log, "stop")
    process.stdin.close()


def test_gpio_process_that_stood_still_stops_the_motors_when_it_goes_on(tmp_path: Path) -> None:
    """And takes no line that waited meanwhile."""
    log = tmp_path / "log"
    with log.open("wb") as stderr:
        process = subprocess.Popen([sys.executable, "-c", GUARD_PROGRAM], stdin=subprocess.PIPE, stderr=stderr)
    assert process.stdin is not None
    process.stdin.write(b"drive 500 500 %d\n" % (time.monotonic() * 1000 + 1e9))
    process.stdin.flush()
    wait_for_end(log, "drive 500 500")
    process.send_signal(signal.SIGSTOP)
    process.stdin.write(b"drive 700 700 %d\n" % (time.monotonic() * 1000 - 1))
    process.stdin.flush()
    process.send_signal(signal.SIGCONT)
    wait_for_end(log, "stop")
    process.stdin.close()
    assert process.wait(30) == 0
    assert "700" not in log.read_text()


def test_gpio_motors_are_told_when_a_command_ends_not_when_it_was_written() -> None:
    """robot-server may stand still between its decision and the write: what it writes then moves nothing."""
    lines: list[str] = []
    process = SimpleNamespace(send=lines.append)
    motors, pins, made_s = GpioMotors(process, DriveGeometry()), RecordingPins(), time.monotonic() - 2.0
    motors.drive(0.2, 0.0, round((made_s + 0.25) * 1e9))
    Guard(pins).line(lines[0], time.monotonic())
    assert set(pins.history) == {(0, 0)}


def test_gpio_process_that_cannot_start_is_named_in_a_sentence() -> None:
    with pytest.raises(DeviceUnavailable, match=r"pi\.gpio_pins"):
        GpioProcess((1, 2, 3, 4, 5, 6), [sys.executable, "-c", "raise SystemExit('no pins here')"])


def test_gpio_motors_drive_and_stop_through_their_process() -> None:
    process = GpioProcess((1, 2, 3, 4, 5, 6), [sys.executable, "-c", GUARD_PROGRAM])
    motors = GpioMotors(process, DriveGeometry())
    motors.drive(0.2, 0.0, soon_ns())
    motors.stop()
    motors.close()
    motors.stop()
    with pytest.raises(DeviceLost):
        motors.drive(0.2, 0.0, soon_ns())


def test_another_process_stops_the_motors_when_the_one_that_owned_the_pins_was_killed(tmp_path: Path) -> None:
    pytest.importorskip("gpiozero")
    log, pins = tmp_path / "pins", (17, 27, 23, 24, 12, 13)
    process = GpioProcess(pins, [sys.executable, "-m", "tests.support.mock_gpio", str(log), *map(str, pins)])
    motors = GpioMotors(process, DriveGeometry())

    def are_turning() -> bool:
        return any(mock_gpio.states(log).get(pin, 0.0) for pin in pins[:4])

    def drive_off() -> None:
        deadline = time.monotonic() + 60
        while not are_turning():
            assert time.monotonic() < deadline
            with contextlib.suppress(DeviceLost):
                motors.drive(0.3, 0.0, soon_ns())
            time.sleep(0.01)

    (owner,) = [child for child in psutil.Process().children() if str(log) in child.cmdline()]
    drive_off()
    owner.suspend()
    while not are_turning():  # it had stopped them by itself before it stood still
        owner.resume()
        drive_off()
        owner.suspend()
    owner.kill()
    owner.wait(30)
    assert are_turning()
    motors.stop()  # as robot-server does when its driver falls silent
    deadline = time.monotonic() + 60
    while are_turning():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    drive_off()
    motors.close()
    assert not are_turning()


def test_gpiozero_motors_turn_the_pins_they_are_given(monkeypatch: pytest.MonkeyPatch) -> None:
    gpiozero = pytest.importorskip("gpiozero")
    mock = pytest.importorskip("gpiozero.pins.mock")
    from robot.devices.pi.gpio_pins import GpioPins

    factory = mock.MockFactory(pin_class=mock.MockPWMPin)
    monkeypatch.setattr(gpiozero.Device, "pin_factory", factory)
    pins = GpioPins((17, 27), (23, 24), (12, 13))
    pins.drive(500, -1000)
    assert [factory.pin(n).state for n in (17, 27, 23, 24)] == [0.5, 0, 0, 1]
    pins.stop()
    assert [factory.pin(n).state for n in (17, 27, 23, 24)] == [0, 0, 0, 0]
    factory.reset()


@pytest.fixture
def _i2c() -> Iterator[None]:
    pi_stubs.install()
    yield
    pi_stubs.uninstall()


@pytest.mark.usefixtures("_i2c")
def test_the_ina219_is_read_as_its_datasheet_says(monkeypatch: pytest.MonkeyPatch) -> None:
    battery = Ina219Battery(1, 0x40, 6.4, 8.4)
    monkeypatch.setattr(pi_stubs.StubIna219, "voltage_v", 6.9)
    assert battery.read() == BatteryState(pytest.approx(6.9, abs=0.002), pytest.approx(0.25, abs=0.001))
    monkeypatch.setattr(pi_stubs.StubSMBus, "connected", False)
    with pytest.raises(DeviceLost, match="0x40"):
        battery.read()


@pytest.mark.usefixtures("_i2c")
def test_a_missing_i2c_bus_or_chip_is_named_with_its_remedy() -> None:
    with pytest.raises(DeviceUnavailable, match="raspi-config"):
        Ina219Battery(7, 0x40, 6.4, 8.4)
    with pytest.raises(DeviceLost, match="0x41"):
        Ina219Battery(1, 0x41, 6.4, 8.4).read()


def test_settings_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(ConfigError, match="battery_empty_v"):
        adapter.open_pi(PiConfig(battery_empty_v=9.0))
    with pytest.raises(ConfigError, match="twice"):
        adapter.open_pi(PiConfig(gpio_pins=(1, 1, 2, 3, 4, 5)))
    with pytest.raises(ConfigError, match="640x480"):
        adapter.load_calibration(PiConfig(width=1280, height=720))


def test_a_robot_without_a_calibration_says_that_its_cameras_numbers_are_anothers() -> None:
    camera, reference = adapter.load_calibration(PiConfig()).camera, REFERENCE_ROBOT.camera
    assert camera is not None and reference is not None and not camera.is_measured
    assert camera.fx == reference.fx


def test_a_robot_that_keeps_a_calibration_has_its_head_too() -> None:
    own = msgspec.structs.replace(REFERENCE_ROBOT, head=None)  # no calibration file holds it
    assert adapter.load_calibration(PiConfig(), own).head == REFERENCE_ROBOT.head


def test_a_camera_calibrated_alone_is_mounted_and_timed_as_the_reference_robots(tmp_path: Path) -> None:
    file = tmp_path / "camera.yaml"
    file.write_text("resolution: [640, 480]\nintrinsics: [1000.0, 1001.0, 320.0, 240.0]\n")
    config, reference = PiConfig(calibration=str(tmp_path)), REFERENCE_ROBOT.camera
    own = adapter.load_calibration(config).camera
    assert own is not None and reference is not None and own.fx == 1000.0 and own.is_measured
    assert (own.T_body_cam, own.time_shift_s) == (reference.T_body_cam, reference.time_shift_s)
    file.write_text(file.read_text() + "T_BS: [1, 0, 0, 0.1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\ntime_shift_s: 0.0\n")
    own = adapter.load_calibration(config).camera
    assert own is not None and own.T_body_cam[3] == 0.1 and own.time_shift_s == 0.0
    file.write_text(file.read_text() + "approximate: true\n")
    own = adapter.load_calibration(config).camera
    assert own is not None and not own.is_measured


def test_a_robots_own_imu_noise_is_read_beside_its_camera_or_alone(tmp_path: Path) -> None:
    (tmp_path / "imu.yaml").write_text("gyroscope_noise_density: 1.0e-4\nupdate_rate: 225.0\n")
    own, reference = adapter.load_calibration(PiConfig(calibration=str(tmp_path))), REFERENCE_ROBOT.imu
    assert own.imu is not None and reference is not None and own.camera is not None
    assert (own.imu.gyro_density, own.imu.rate_hz) == (1e-4, 225.0)
    assert (own.imu.gyro_range, own.imu.accel_range) == (reference.gyro_range, reference.accel_range)
    assert not own.camera.is_measured
    (tmp_path / "camera.yaml").write_text("resolution: [640, 480]\nintrinsics: [1000.0, 1001.0, 320.0, 240.0]\n")
    both = adapter.load_calibration(PiConfig(calibration=str(tmp_path)))
    assert both.imu == own.imu and both.camera is not None and both.camera.fx == 1000.0


def test_a_calibration_folder_with_neither_file_names_the_one_that_is_missing(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"camera\.yaml"):
        adapter.load_calibration(PiConfig(calibration=str(tmp_path)))


def test_a_missing_serial_port_is_named_with_its_remedy() -> None:
    with pytest.raises(DeviceUnavailable, match=r"/dev/no-such-mega.*dialout"):
        adapter.open_pi(PiConfig(serial_port="/dev/no-such-mega", camera=False))
