"""A navigation as a COLMAP model in text: cameras.txt, images.txt, points3D.txt, and the keyframes beside them.

Source of the format: COLMAP's documentation, "Output format". COLMAP's pixel (0, 0) is the corner of the top-left
pixel, ours its centre; its poses are cam_from_world, our T_cam_world.
"""

from __future__ import annotations

from pathlib import Path

from shared.calibration import CameraCalibration
from shared.errors import DataError
from shared.geometry import inverse, quat_from_rotation
from station.model.navigation import Navigation

PIXEL_CENTRE = 0.5  # from our pixels to COLMAP's
CAMERA_ID = 1


def export_colmap(nav: Navigation, folder: Path) -> None:
    """Write the model into a new folder, images in `images/`. Raises DataError for a navigation without camera."""
    camera = nav.calibration.camera
    if camera is None:
        raise DataError(f"{nav.id} has no camera calibration; COLMAP's format needs one")
    (folder / "images").mkdir(parents=True)
    (folder / "cameras.txt").write_text(_camera_line(camera))
    names = [_image_name(k, encoded) for k, encoded in enumerate(nav.keyframes.encoded)]
    for name, encoded in zip(names, nav.keyframes.encoded, strict=True):
        if encoded:
            (folder / "images" / name).write_bytes(encoded)
    landmarks = nav.landmarks
    observed = landmarks.observations_by_keyframe(len(nav.keyframes))
    image_lines: list[str] = []
    tracks: list[list[str]] = [[] for _ in range(len(landmarks))]
    for k, name in enumerate(names):
        T_cam_world = inverse(nav.keyframes.T_world_cam[k])
        numbers = [*quat_from_rotation(T_cam_world[:3, :3]), *T_cam_world[:3, 3]]
        image_lines.append(f"{k + 1} {' '.join(f'{x:.12g}' for x in numbers)} {CAMERA_ID} {name}\n")
        points = []
        for position, row in enumerate(observed[k]):
            u, v = landmarks.observed_uv_px[row] + PIXEL_CENTRE
            landmark = int(landmarks.observed_landmark[row])
            points.append(f"{u:.6g} {v:.6g} {landmark + 1}")
            tracks[landmark].append(f"{k + 1} {position}")
        image_lines.append(" ".join(points) + "\n")
    (folder / "images.txt").write_text("".join(image_lines))
    rows = []
    for number, (p, rgb, track) in enumerate(zip(landmarks.p_world, landmarks.rgb, tracks, strict=True), start=1):
        if track:  # a point that no keyframe saw has no place in a COLMAP model
            x, y, z = p
            rows.append(f"{number} {x:.12g} {y:.12g} {z:.12g} {rgb[0]} {rgb[1]} {rgb[2]} 0 {' '.join(track)}\n")
    (folder / "points3D.txt").write_text("".join(rows))


def _camera_line(camera: CameraCalibration) -> str:
    k1, k2, p1, p2 = (*camera.distortion, 0.0, 0.0, 0.0, 0.0)[:4]
    model = "OPENCV" if camera.model == "radtan" else "OPENCV_FISHEYE"
    numbers = [camera.fx, camera.fy, camera.cx + PIXEL_CENTRE, camera.cy + PIXEL_CENTRE, k1, k2, p1, p2]
    return f"{CAMERA_ID} {model} {camera.width} {camera.height} {' '.join(f'{x:.12g}' for x in numbers)}\n"


def _image_name(number: int, encoded: bytes) -> str:
    return f"{number:06d}{'.png' if encoded.startswith(b'PNG', 1) else '.jpg'}"
