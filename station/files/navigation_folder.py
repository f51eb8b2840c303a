"""A navigation as a folder (CONTRACT: Files written), and back.

```
trajectory.tum      t x y z qx qy qz qw, seconds with nine digits: nanoseconds survive
landmarks.ply       x y z (double), red green blue, first_frame, num_observations, cov_* (6, upper triangle)
navigation.json     the report
calibration.json    camera and IMU the navigation was made with
keyframes/          NNNNNN.jpg|png as recorded, and observations.npz: poses, segments, observations
depth.npz           where depth was measured: times, and pictures in mm with the pixels that were kept
pictures.npz        derived, may be missing: what localisation sees in the keyframes (places/localisation)
```
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from shared.bounded import MAX_FILE_BYTES, MAX_JSON_BYTES, MAX_LINE_BYTES, MB, parse_json, read_file, shown
from shared.calibration import Calibration, DepthCalibration
from shared.disk import make_folder, replacing_folder, settle_folder
from shared.errors import ConfigError, DataError
from shared.geometry import FloatArray, IntArray, are_poses, pose, quat_from_rotation
from shared.recorded_files import MAX_TIME_NS
from station.files.npz import UNREADABLE, open_arrays
from station.files.ply import Columns, cloud_columns, decode_ply, encode_ply
from station.model.navigation import DepthScans, Keyframes, Landmarks, Navigation, NavigationReport, Trajectory

TRAJECTORY, LANDMARKS, REPORT, CALIBRATION = "trajectory.tum", "landmarks.ply", "navigation.json", "calibration.json"
IMAGES = "keyframes"
OBSERVATIONS = f"{IMAGES}/observations.npz"
PICTURES = "pictures.npz"
DEPTH = "depth.npz"
OUR_ENTRIES = {TRAJECTORY, LANDMARKS, REPORT, CALIBRATION, IMAGES, DEPTH, PICTURES}
OUR_ENTRIES |= {f".{PICTURES}"}  # half-written
_MAX_BYTES = {REPORT: MAX_JSON_BYTES, CALIBRATION: MAX_JSON_BYTES, TRAJECTORY: 256 * MB}
PNG_MAGIC = b"\x89PNG"
_OF_KEYFRAMES = ("frame_index", "t_robot_ns", "T_world_cam", "segment", "names")
_OF_OBSERVATIONS = ("observed_landmark", "observed_keyframe", "observed_uv_px")
UPPER = np.triu_indices(3)
COV_COLUMNS = [f"cov_{'xyz'[i]}{'xyz'[j]}" for i, j in zip(*UPPER, strict=True)]


def save_navigation(nav: Navigation, folder: Path) -> None:
    """Write a navigation, whole or not at all: into a new folder that then takes the name.

    Raises:
        DataError: the folder holds something else already, or cannot be written.
    """
    folder = folder.absolute()
    try:
        check_navigation_folder(folder)
        make_folder(folder.parent)
        with replacing_folder(folder) as fresh:
            (fresh / IMAGES).mkdir()
            for name, content in encode_navigation(nav).items():
                (fresh / name).write_bytes(content)
    except OSError as exc:
        raise DataError(f"{folder} cannot be written ({exc.strerror}); choose another folder") from exc


def check_navigation_folder(folder: Path) -> None:
    """Whether a navigation may take this name. Raises DataError where something else has it."""
    if folder.exists():
        foreign = {p.name for p in folder.iterdir()} - OUR_ENTRIES if folder.is_dir() else {folder.name}
        if foreign:
            raise DataError(f"{folder} holds {sorted(foreign)[0]}, which is no part of a navigation; give a new folder")


def load_navigation(folder: Path) -> Navigation:
    """Read what save_navigation wrote. Raises DataError naming the file that is missing or damaged."""
    settle_folder(folder)
    if not (folder / REPORT).is_file():
        raise DataError(f"{folder} holds no navigation (no {REPORT}); give a folder written by `station slam`")
    has_depth = (folder / DEPTH).exists()
    return decode_navigation(
        lambda name: read_file(folder / name, _MAX_BYTES.get(name, MAX_FILE_BYTES)), folder, has_depth=has_depth
    )


def encode_navigation(nav: Navigation) -> dict[str, bytes]:
    """The files of a navigation: their paths in its folder, and what is in them. Equal navigations give equal bytes."""
    report = {"id": nav.id, **msgspec.to_builtins(nav.report)}
    names = []
    for i, encoded in enumerate(nav.keyframes.encoded):
        suffix = ".png" if encoded.startswith(PNG_MAGIC) else ".jpg"
        names.append(f"{i:06d}{suffix}" if encoded else "")
    observations = io.BytesIO()
    np.savez(
        observations,
        frame_index=nav.keyframes.frame_index,
        t_robot_ns=nav.keyframes.t_robot_ns,
        T_world_cam=nav.keyframes.T_world_cam,
        segment=nav.keyframes.segment,
        names=np.array(names, dtype=np.str_),
        observed_landmark=nav.landmarks.observed_landmark,
        observed_keyframe=nav.landmarks.observed_keyframe,
        observed_uv_px=nav.landmarks.observed_uv_px,
    )
    files = {
        TRAJECTORY: format_tum(nav.trajectory).encode(),
        REPORT: (json.dumps(report, indent=2, default=str) + "\n").encode(),
        CALIBRATION: msgspec.json.format(msgspec.json.encode(nav.calibration)),
        LANDMARKS: encode_ply(_landmark_columns(nav)),
        OBSERVATIONS: observations.getvalue(),
    }
    if nav.depth is not None:
        files[DEPTH] = _encode_depth(nav.depth)
    images = zip(names, nav.keyframes.encoded, strict=True)
    return files | {f"{IMAGES}/{name}": encoded for name, encoded in images if name}


def decode_navigation(read: Callable[[str], bytes], folder: Path, *, has_depth: bool) -> Navigation:
    """A navigation from its files; `read` gives the bytes of one by its path, `folder` is what messages call the whole.

    Raises:
        DataError: a file is missing (`read` raised OSError) or damaged; names it.
    """
    report_path = folder / REPORT
    content = _json(read, report_path)
    if not isinstance(content, dict):
        raise DataError(f"{report_path} holds no report; make the navigation again")
    identity = str(content.pop("id", folder.name))
    try:
        report = msgspec.convert(content, NavigationReport)
    except msgspec.ValidationError as exc:
        raise DataError(f"{report_path} is damaged ({exc}); make the navigation again") from exc
    calibration_path = folder / CALIBRATION
    try:
        calibration = msgspec.convert(_without_nulls(_json(read, calibration_path)), Calibration)
    except (msgspec.ValidationError, ConfigError) as exc:
        raise DataError(f"{calibration_path} is damaged ({exc}); make the navigation again") from exc
    keyframes, observations = _decode_keyframes(read, folder)
    landmarks = _decode_landmarks(read, folder, observations, len(keyframes))
    trajectory = parse_tum(_text(read, folder / TRAJECTORY), folder / TRAJECTORY)
    depth = _decode_depth(read, folder) if has_depth else None
    return Navigation(identity, calibration, trajectory, keyframes, landmarks, report, depth)


def format_tum(trajectory: Trajectory) -> str:
    """The text of a TUM file: poses as `t x y z qx qy qz qw`, t in s with all nanoseconds."""
    lines = []
    for t_ns, T in zip(trajectory.t_robot_ns.tolist(), trajectory.T_world_body, strict=True):
        w, x, y, z = quat_from_rotation(T[:3, :3])
        px, py, pz = T[:3, 3]
        lines.append(f"{format_seconds(t_ns)} {px:.9g} {py:.9g} {pz:.9g} {x:.12g} {y:.12g} {z:.12g} {w:.12g}\n")
    return "".join(lines)


def format_seconds(t_ns: int) -> str:
    """Nanoseconds as seconds, exactly."""
    sign, t_ns = ("-", -t_ns) if t_ns < 0 else ("", t_ns)
    return f"{sign}{t_ns // 1_000_000_000}.{t_ns % 1_000_000_000:09d}"


def parse_tum(text: str, path: Path) -> Trajectory:
    """Poses from the text of a TUM file; `path` is what messages call it. Raises DataError naming the line."""
    times: list[int] = []
    poses: list[FloatArray] = []
    for line_number, line in enumerate(text.splitlines(), start=1):
        words = line[:MAX_LINE_BYTES].split()
        if not words or words[0].startswith("#"):
            continue
        try:
            times.append(_parse_seconds(words[0]))
            x, y, z, qx, qy, qz, qw = (float(word) for word in words[1:8])
            poses.append(pose(np.array([x, y, z]), np.array([qw, qx, qy, qz])))
        except ValueError as exc:
            raise DataError(f"{path} line {line_number} is not `t x y z qx qy qz qw`; make the file again") from exc
        if len(times) > 1 and times[-1] < times[-2]:
            raise DataError(f"{path} line {line_number} is earlier than the line before; sort the file by time")
    return Trajectory(np.array(times, dtype=np.int64), np.array(poses).reshape(-1, 4, 4))


def _parse_seconds(text: str) -> int:
    whole, _, fraction = text.partition(".")
    t_ns = int(whole) * 1_000_000_000
    t_ns += (-1 if whole.startswith("-") else 1) * int((fraction + "0" * 9)[:9])
    if abs(t_ns) > MAX_TIME_NS:
        raise ValueError(f"{shown(t_ns)} is no time")
    return t_ns


def _landmark_columns(nav: Navigation) -> Columns:
    landmarks = nav.landmarks
    first = landmarks.first_keyframe()
    seen = first >= 0
    frames = np.full(len(landmarks), -1, dtype=np.int32)
    frames[seen] = nav.keyframes.frame_index[first[seen]]
    columns = cloud_columns(landmarks.p_world.astype(np.float64), landmarks.rgb)
    columns |= {"first_frame": frames, "num_observations": landmarks.num_observations.astype(np.int32)}
    return columns | {
        name: landmarks.cov_world[:, i, j].astype(np.float32) for name, i, j in zip(COV_COLUMNS, *UPPER, strict=True)
    }


def _without_nulls(content: Any) -> Any:
    """JSON knows no infinity: a sensor range without limit was written as null; left out, it is that again."""
    if not isinstance(content, dict):
        return content
    return {
        name: {key: value for key, value in sensor.items() if value is not None} if isinstance(sensor, dict) else sensor
        for name, sensor in content.items()
    }


def _text(read: Callable[[str], bytes], path: Path) -> str:
    try:
        return read(path.name).decode("utf-8")
    except (OSError, UnicodeDecodeError) as exc:
        raise DataError(f"{path} is missing or damaged ({exc}); make the navigation again") from exc


def _json(read: Callable[[str], bytes], path: Path) -> Any:
    try:
        return parse_json(_text(read, path))
    except ValueError as exc:
        raise DataError(f"{path} is missing or damaged ({exc}); make the navigation again") from exc


def _decode_keyframes(
    read: Callable[[str], bytes], folder: Path
) -> tuple[Keyframes, tuple[IntArray, IntArray, FloatArray]]:
    path = folder / OBSERVATIONS
    try:
        with io.BytesIO(read(OBSERVATIONS)) as file, open_arrays(file) as arrays:
            content = {key: arrays.read(key) for key in (*_OF_KEYFRAMES, *_OF_OBSERVATIONS)}
        images = [f"{IMAGES}/{Path(str(name)).name}" if name else "" for name in content["names"]]
        encoded = {name: read(name) for name in set(images) - {""}}
        keyframes = Keyframes(
            frame_index=content["frame_index"].astype(np.int64),
            t_robot_ns=content["t_robot_ns"].astype(np.int64),
            T_world_cam=content["T_world_cam"].astype(np.float64).reshape(-1, 4, 4),
            encoded=tuple(encoded.get(name, b"") for name in images),
            segment=content["segment"].astype(np.int64),
        )
        observations = (
            content["observed_landmark"].astype(np.int64),
            content["observed_keyframe"].astype(np.int64),
            content["observed_uv_px"].astype(np.float64).reshape(-1, 2),
        )
    except OSError as exc:
        what = f"{exc.filename or path} is missing or damaged ({exc.strerror})"
        raise DataError(f"{what}; make the navigation again") from exc
    except UNREADABLE as exc:
        raise DataError(f"{path} is damaged ({exc}); make the navigation again") from exc
    if not are_poses(keyframes.T_world_cam) or not np.isfinite(observations[2]).all():
        raise DataError(f"{path} is damaged (a pose of it is none, or an observation is nowhere); make it again")
    counts = {len(keyframes.frame_index), len(keyframes), len(keyframes.T_world_cam), len(keyframes.segment)}
    if len(counts) != 1 or len({len(column) for column in observations}) != 1:
        raise DataError(f"{path} is damaged (its arrays differ in length); make the navigation again")
    return keyframes, observations


def _encode_depth(depth: DepthScans) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(
        file,
        t_robot_ns=depth.t_robot_ns,
        millimetres=depth.millimetres,
        sensor=np.frombuffer(msgspec.json.encode(depth.sensor), dtype=np.uint8),
    )
    return file.getvalue()


def _decode_depth(read: Callable[[str], bytes], folder: Path) -> DepthScans:
    try:
        with open_arrays(io.BytesIO(read(DEPTH))) as arrays:
            t_ns, millimetres = arrays.read("t_robot_ns").astype(np.int64), arrays.read("millimetres")
            sensor = msgspec.json.decode(arrays.read("sensor").tobytes(), type=DepthCalibration)
        if millimetres.dtype != np.uint16 or millimetres.shape != (len(t_ns), sensor.height, sensor.width):
            raise ValueError("its pictures are not what it says")
    except (*UNREADABLE, msgspec.DecodeError, ConfigError) as exc:
        raise DataError(f"{folder / DEPTH} is damaged ({exc}); make the navigation again") from exc
    return DepthScans(t_ns, millimetres, sensor)


def _decode_landmarks(
    read: Callable[[str], bytes],
    folder: Path,
    observations: tuple[IntArray, IntArray, FloatArray],
    num_keyframes: int,
) -> Landmarks:
    path = folder / LANDMARKS
    try:
        columns = decode_ply(read(LANDMARKS), path)
    except OSError as exc:
        raise DataError(f"{path} is missing or damaged ({exc.strerror}); make the navigation again") from exc
    p_world = np.column_stack([columns[axis] for axis in "xyz"]).astype(np.float64)
    count = len(p_world)
    grey = np.full(count, 128, dtype=np.uint8)
    rgb = np.column_stack([columns.get(name, grey) for name in ("red", "green", "blue")]).astype(np.uint8)
    cov = np.zeros((count, 3, 3))
    for name, i, j in zip(COV_COLUMNS, *UPPER, strict=True):
        cov[:, i, j] = cov[:, j, i] = columns.get(name, np.zeros(count))
    landmark, keyframe, uv = observations
    for name, index, limit in (("landmark", landmark, count), ("keyframe", keyframe, num_keyframes)):
        if len(index) and not (int(index.min()) >= 0 and int(index.max()) < limit):
            raise DataError(f"{folder} is damaged: an observation names a {name} that is not there; make it again")
    return Landmarks(p_world, rgb, cov, landmark, keyframe, uv)
