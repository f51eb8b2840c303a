"""Depth pictures reach a station a few times a second, and take no more than a share of a thin link."""

from __future__ import annotations

import cv2
import msgspec
import numpy as np
import pytest

from robot.depth import LEAST_INTERVAL_NS, SHARE, DepthSlot, DepthStream
from robot.devices.ports import CapturedDepth
from robot.link_meter import LinkEstimate, LinkMeter
from robot.simulation.config import DepthSensorModel
from robot.simulation.depth import SimulatedDepth, depth_calibration
from shared.calibration import REFERENCE_CAMERA, CameraCalibration
from station.vision.lens import Lens

MS, S = 1_000_000, 1_000_000_000


def sent(slot: DepthSlot, stream: DepthStream, seconds: float, num_bytes: int) -> list[int]:
    """Times at which pictures went, of a sensor that makes a hundred a second."""
    times = []
    for t_ns in range(0, round(seconds * S), 10 * MS):
        slot.put(CapturedDepth(t_ns, bytes(num_bytes)))
        if (depth := stream.next_depth(t_ns)) is not None:
            assert depth.t_robot_ns == t_ns and depth.seq == slot.count - 1 and stream.is_at_end
            times.append(t_ns)
    return times


def test_the_newest_goes_four_times_a_second_on_this_machine() -> None:
    slot = DepthSlot()
    slot.put(CapturedDepth(-1, b"old"))
    stream = DepthStream(slot, LinkMeter(), is_on_this_machine=True)
    assert stream.next_depth(0) is None and stream.is_at_end
    assert np.diff(sent(slot, stream, 2.0, 1000)).tolist() == [LEAST_INTERVAL_NS] * 7


def test_beyond_it_no_large_one_goes_until_the_link_is_known() -> None:
    slot, meter = DepthSlot(), LinkMeter()
    stream = DepthStream(slot, meter, is_on_this_machine=False)
    assert sent(slot, stream, 1.0, 1000) == []
    assert not stream.is_at_end


def test_a_range_sensor_goes_also_where_no_camera_tells_what_the_link_carries() -> None:
    """Its picture is one pixel, and a robot with Mega and HC-SR04 alone has no other."""
    slot = DepthSlot()
    pixel = cv2.imencode(".png", np.full((1, 1), 1234, np.uint16))[1].tobytes()
    stream = DepthStream(slot, LinkMeter(), is_on_this_machine=False)
    assert np.diff(sent(slot, stream, 2.0, len(pixel))).tolist() == [LEAST_INTERVAL_NS] * 7


@pytest.mark.parametrize(("bytes_per_s", "size"), [(1e6, 200_000), (1e6, 1000), (2e5, 40_000)])
@pytest.mark.parametrize("is_relayed", [False, True])
def test_depth_takes_a_quarter_of_what_the_link_carries(bytes_per_s: float, size: int, is_relayed: bool) -> None:
    slot, meter = DepthSlot(), LinkMeter()
    meter.estimate = LinkEstimate(bytes_per_s=bytes_per_s, trip_ns=10 * MS, other_bytes_per_s=0.0)
    times = sent(slot, DepthStream(slot, meter, is_on_this_machine=is_relayed), 20.0, size)
    assert len(times) > 3
    assert len(times) * size <= SHARE * bytes_per_s * 20.0 + size
    assert min(np.diff(times)) >= LEAST_INTERVAL_NS


def test_no_depth_goes_behind_which_pictures_would_be_too_old() -> None:
    slot, meter = DepthSlot(), LinkMeter()
    meter.estimate = LinkEstimate(bytes_per_s=2e5, trip_ns=10 * MS, other_bytes_per_s=0.0)
    stream = DepthStream(slot, meter, is_on_this_machine=False)
    assert sent(slot, stream, 5.0, 300_000) == []
    assert stream.is_at_end
    assert sent(slot, stream, 5.0, 1000) != []


PINHOLE = msgspec.structs.replace(REFERENCE_CAMERA, distortion=(0.0,) * 4)
FISHEYE = msgspec.structs.replace(
    REFERENCE_CAMERA, fx=300.0, fy=300.0, model="equidistant", distortion=(0.01, -0.005, 0.002, 0.0)
)


@pytest.mark.parametrize("camera", [PINHOLE, REFERENCE_CAMERA, FISHEYE], ids=["pinhole", "radtan", "fisheye"])
@pytest.mark.parametrize("columns", [8, 64])
def test_a_simulated_sensor_measures_what_the_camera_sees(camera: CameraCalibration, columns: int) -> None:
    """A wall askew, of which the inverse depth is linear in the ray."""
    told = depth_calibration(camera, DepthSensorModel(columns=columns))
    lens = Lens(camera)
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64)
    xy = lens.unproject(np.stack([u, v], axis=-1))
    inverse_depth = (0.5 + 0.3 * xy[..., 0] - 0.2 * xy[..., 1]).astype(np.float32)
    sensor = SimulatedDepth(told, camera, DepthSensorModel(columns=columns, noise=0.0, max_m=60.0), 0)
    image = cv2.imdecode(np.frombuffer(sensor.measure(inverse_depth), np.uint8), cv2.IMREAD_UNCHANGED)
    assert image.dtype == np.uint16 and image.shape == (told.height, told.width)
    y, x = np.mgrid[0 : told.height, 0 : told.width]
    ray = np.stack([(x - told.cx) / told.fx, (y - told.cy) / told.fy])
    expected = 1000 / (0.5 + 0.3 * ray[0] - 0.2 * ray[1])
    assert (image > 0).mean() > 0.9
    # The nearest pixel is looked at; off the axis of a fisheye it is wider as rays go.
    within_pixel = 0.5 * np.hypot(0.3, 0.2) * np.sqrt(2) / camera.fx * (1 + (ray**2).sum(axis=0))
    sees = image > 0
    off = np.abs(1000 / image[sees] - 1000 / expected[sees])
    assert (off <= within_pixel[sees] + 0.0005 / (expected[sees] / 1000) ** 2).all()


def test_a_simulated_sensor_is_noisy_and_sees_no_further_than_it_can() -> None:
    model = DepthSensorModel(columns=64, noise=0.02, max_m=4.0)
    sensor = SimulatedDepth(depth_calibration(PINHOLE, model), PINHOLE, model, 1)
    inverse_depth = np.full((480, 640), 0.5, np.float32)
    inverse_depth[:240] = 0.2
    image = cv2.imdecode(np.frombuffer(sensor.measure(inverse_depth), np.uint8), cv2.IMREAD_UNCHANGED)
    assert (image[:23] == 0).all()
    assert np.std(image[25:] / 2000.0) == pytest.approx(0.02, rel=0.1)
    assert np.mean(image[25:]) == pytest.approx(2000, rel=0.003)


def test_a_simulated_cone_hears_the_nearest_thing_that_stands_in_it() -> None:
    model = DepthSensorModel(columns=1, noise=0.0, max_m=4.0)
    told = depth_calibration(PINHOLE, model)
    assert told.is_cone and (told.width, told.height) == (1, 1)
    sensor = SimulatedDepth(told, PINHOLE, model, 1)

    def heard(inverse_depth: np.ndarray) -> int:
        return int(cv2.imdecode(np.frombuffer(sensor.measure(inverse_depth), np.uint8), cv2.IMREAD_UNCHANGED)[0, 0])

    wall = np.full((480, 640), 0.5, np.float32)
    assert heard(wall) == pytest.approx(2000, abs=2)
    wall[100:140, 8:16] = 1.0  # a leg at 1 m, at the edge: its way is longer than its depth
    assert (
        1000
        < heard(wall)
        == pytest.approx(1000 * np.hypot(1.0, np.hypot((12 - PINHOLE.cx), 120 - PINHOLE.cy) / 1083), rel=0.01)
    )
    v = np.arange(480.0)[:, None] - PINHOLE.cy
    floor = np.broadcast_to(np.maximum(v, 0.0) / PINHOLE.fy / 0.25, (480, 640)).astype(np.float32)
    assert heard(floor) == 0 and heard(np.maximum(floor, 0.4).astype(np.float32)) == pytest.approx(2500, abs=2)
    assert heard(np.full((480, 640), 0.2, np.float32)) == 0
