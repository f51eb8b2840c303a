"""A navigation as a folder (CONTRACT: Files written), and back.

```
trajectory.tum      t x y z qx qy qz qw, seconds with nine digits: nanoseconds survive
landmarks.ply       x y z (double), red green blue, first_frame, num_observations, cov_* (6, upper triangle)
navigation.json     the report
calibration.json    camera and IMU the navigation was made with
keyframes/          NNNNNN.jpg|png as recorded, and observations.npz: poses, segments, observations
```
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from shared.calibration import Calibration
from shared.errors import ConfigError, DataError
from shared.geometry import FloatArray, IntArray, quat_from_rotation, rotation_from_quat, se3
from station.navigation import Keyframes, Landmarks, Navigation, NavigationReport, Trajectory
from station.ply import read_ply, write_ply

OUR_ENTRIES = {"trajectory.tum", "landmarks.ply", "navigation.json", "calibration.json", "keyframes"}
PNG_MAGIC = b"\x89PNG"
OBSERVATIONS = "observations.npz"
UPPER = np.triu_indices(3)
COV_COLUMNS = [f"cov_{'xyz'[i]}{'xyz'[j]}" for i, j in zip(*UPPER, strict=True)]


def save_navigation(nav: Navigation, folder: Path) -> None:
    """Write a navigation, whole or not at all: into a new folder that then takes the name.

    Raises:
        DataError: the folder holds something else already, or cannot be written.
    """
    folder = folder.absolute()
    if folder.exists():
        foreign = {p.name for p in folder.iterdir()} - OUR_ENTRIES if folder.is_dir() else {folder.name}
        if foreign:
            raise DataError(f"{folder} holds {sorted(foreign)[0]}, which is no part of a navigation; give a new folder")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    except OSError as exc:
        raise DataError(f"{folder} cannot be written ({exc.strerror}); choose another folder") from exc
    try:
        fresh = scratch / "fresh"
        _write(nav, fresh)
        if folder.exists():
            folder.rename(scratch / "old")
        fresh.rename(folder)
    except OSError as exc:
        raise DataError(f"{folder} cannot be written ({exc.strerror}); choose another folder") from exc
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def load_navigation(folder: Path) -> Navigation:
    """Read what save_navigation wrote. Raises DataError naming the file that is missing or damaged."""
    report_path = folder / "navigation.json"
    if not report_path.is_file():
        raise DataError(f"{folder} holds no navigation (no navigation.json); give a folder written by `station slam`")
    content = _read_json(report_path)
    if not isinstance(content, dict):
        raise DataError(f"{report_path} holds no report; make the navigation again")
    identity = str(content.pop("id", folder.name))
    try:
        report = msgspec.convert(content, NavigationReport)
    except msgspec.ValidationError as exc:
        raise DataError(f"{report_path} is damaged ({exc}); make the navigation again") from exc
    calibration_path = folder / "calibration.json"
    try:
        calibration = msgspec.convert(_without_nulls(_read_json(calibration_path)), Calibration)
    except (msgspec.ValidationError, ConfigError) as exc:
        raise DataError(f"{calibration_path} is damaged ({exc}); make the navigation again") from exc
    keyframes, observations = _read_keyframes(folder / "keyframes")
    landmarks = _read_landmarks(folder, observations, len(keyframes))
    return Navigation(identity, calibration, read_tum(folder / "trajectory.tum"), keyframes, landmarks, report)


def write_tum(trajectory: Trajectory, path: Path) -> None:
    """Poses as `t x y z qx qy qz qw`, t in s with all nanoseconds."""
    path.write_text(format_tum(trajectory))


def format_tum(trajectory: Trajectory) -> str:
    """The text of a TUM file."""
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


def read_tum(path: Path) -> Trajectory:
    """Poses from a TUM file. Raises DataError naming the line that is wrong."""
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as exc:
        raise DataError(f"{path} cannot be read as text ({exc}); make it again") from exc
    times: list[int] = []
    poses: list[FloatArray] = []
    for line_number, line in enumerate(lines, start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            whole, _, fraction = words[0].partition(".")
            t_ns = int(whole) * 1_000_000_000
            t_ns += (-1 if whole.startswith("-") else 1) * int((fraction + "0" * 9)[:9])
            x, y, z, qx, qy, qz, qw = (float(word) for word in words[1:8])
        except ValueError as exc:
            raise DataError(f"{path} line {line_number} is not `t x y z qx qy qz qw`; make the file again") from exc
        times.append(t_ns)
        poses.append(se3(rotation_from_quat(np.array([qw, qx, qy, qz])), np.array([x, y, z])))
    return Trajectory(np.array(times, dtype=np.int64), np.array(poses).reshape(-1, 4, 4))


def _write(nav: Navigation, folder: Path) -> None:
    images = folder / "keyframes"
    images.mkdir(parents=True)
    write_tum(nav.trajectory, folder / "trajectory.tum")
    report = {"id": nav.id, **msgspec.to_builtins(nav.report)}
    (folder / "navigation.json").write_text(json.dumps(report, indent=2, default=str) + "\n")
    (folder / "calibration.json").write_bytes(msgspec.json.format(msgspec.json.encode(nav.calibration)))
    _write_landmarks(nav, folder / "landmarks.ply")
    names = []
    for i, encoded in enumerate(nav.keyframes.encoded):
        suffix = ".png" if encoded.startswith(PNG_MAGIC) else ".jpg"
        names.append(f"{i:06d}{suffix}" if encoded else "")
        if encoded:
            (images / names[-1]).write_bytes(encoded)
    np.savez(
        images / OBSERVATIONS,
        frame_index=nav.keyframes.frame_index,
        t_robot_ns=nav.keyframes.t_robot_ns,
        T_world_cam=nav.keyframes.T_world_cam,
        segment=nav.keyframes.segment,
        names=np.array(names, dtype=np.str_),
        observed_landmark=nav.landmarks.observed_landmark,
        observed_keyframe=nav.landmarks.observed_keyframe,
        observed_uv_px=nav.landmarks.observed_uv_px,
    )
    for file in (*folder.iterdir(), images / OBSERVATIONS):
        if file.is_file():
            _flush(file)


def _flush(file: Path) -> None:
    """Onto the disk before the folder takes its name: a power cut must not leave empty files under a good name."""
    descriptor = os.open(file, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _write_landmarks(nav: Navigation, path: Path) -> None:
    landmarks = nav.landmarks
    first = landmarks.first_keyframe()
    seen = first >= 0
    frames = np.full(len(landmarks), -1, dtype=np.int32)
    frames[seen] = nav.keyframes.frame_index[first[seen]]
    columns: dict[str, Any] = {axis: landmarks.p_world[:, i].astype(np.float64) for i, axis in enumerate("xyz")}
    columns |= {name: landmarks.rgb[:, i] for i, name in enumerate(("red", "green", "blue"))}
    columns |= {"first_frame": frames, "num_observations": landmarks.num_observations.astype(np.int32)}
    columns |= {
        name: landmarks.cov_world[:, i, j].astype(np.float32) for name, i, j in zip(COV_COLUMNS, *UPPER, strict=True)
    }
    write_ply(path, columns)


def _without_nulls(content: Any) -> Any:
    """JSON knows no infinity: a sensor range without limit was written as null; left out, it is that again."""
    if not isinstance(content, dict):
        return content
    return {
        name: {key: value for key, value in sensor.items() if value is not None} if isinstance(sensor, dict) else sensor
        for name, sensor in content.items()
    }


def _read_json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as exc:
        raise DataError(f"{path} is missing or damaged ({exc}); make the navigation again") from exc


def _read_keyframes(folder: Path) -> tuple[Keyframes, tuple[IntArray, IntArray, FloatArray]]:
    path = folder / OBSERVATIONS
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            content = {key: archive[key] for key in archive.files}
        keyframes = Keyframes(
            frame_index=content["frame_index"].astype(np.int64),
            t_robot_ns=content["t_robot_ns"].astype(np.int64),
            T_world_cam=content["T_world_cam"].astype(np.float64).reshape(-1, 4, 4),
            encoded=tuple((folder / Path(str(name)).name).read_bytes() if name else b"" for name in content["names"]),
            segment=content["segment"].astype(np.int64),
        )
        observations = (
            content["observed_landmark"].astype(np.int64),
            content["observed_keyframe"].astype(np.int64),
            content["observed_uv_px"].astype(np.float64).reshape(-1, 2),
        )
    except OSError as exc:
        raise DataError(f"{exc.filename or path} is missing or damaged; make the navigation again") from exc
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as exc:
        raise DataError(f"{path} is damaged ({exc}); make the navigation again") from exc
    counts = {len(keyframes.frame_index), len(keyframes), len(keyframes.T_world_cam), len(keyframes.segment)}
    if len(counts) != 1 or len({len(column) for column in observations}) != 1:
        raise DataError(f"{path} is damaged (its arrays differ in length); make the navigation again")
    return keyframes, observations


def _read_landmarks(folder: Path, observations: tuple[IntArray, IntArray, FloatArray], num_keyframes: int) -> Landmarks:
    path = folder / "landmarks.ply"
    columns = read_ply(path)
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
