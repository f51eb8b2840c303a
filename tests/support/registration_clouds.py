"""Synthetic furnished flats as SfM-like point clouds, for `bench_registration.py` and the tests.

A flat is a list of textured rectangles (walls, floor, carpets, pictures, furniture, small objects), each with its own
density of features: white walls have nearly none, posters and shelves many. A drive sees one region of the flat, and in
it only some of the rectangles and only some of each one's features; so two drives share surfaces, and only part of
their landmarks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray, rotation_of, scale_of, se3, so3_log, transform, yaw_rotation


@dataclass(frozen=True, slots=True, eq=False)
class Flat:
    """All features of one flat: candidates for landmarks."""

    points: FloatArray  # (N, 3) m, z up
    patch: FloatArray  # (N,) number of the rectangle each lies on
    extent: FloatArray  # (2,) m


@dataclass(frozen=True, slots=True, eq=False)
class CloudPair:
    """Two drives of one flat (or of two flats) and the truth."""

    target: FloatArray  # (N, 3)
    source: FloatArray  # (M, 3)
    T_target_source: FloatArray | None  # (4, 4) with scale; None: different flats
    overlap: float  # share of the source's region that the target saw, too


def _rectangle(
    rng: np.random.Generator, corner: FloatArray, a: FloatArray, b: FloatArray, density: float
) -> FloatArray:
    area = float(np.linalg.norm(np.cross(a, b)))
    n = rng.poisson(area * density * 2.5)
    if n == 0:
        return np.zeros((0, 3))
    # Features of real textures come in groups (a book, a face on a poster), not evenly.
    groups = max(1, n // 6)
    centres = rng.uniform(0, 1, (groups, 2))
    uv = centres[rng.integers(groups, size=n)] + rng.normal(0, 0.06, (n, 2))
    even = rng.random(n) < 0.4
    uv[even] = rng.uniform(0, 1, (int(even.sum()), 2))
    uv = np.clip(uv, 0, 1)
    return corner + uv[:, :1] * a + uv[:, 1:] * b


def _box(
    rng: np.random.Generator, centre: FloatArray, size: FloatArray, yaw: float, density: float
) -> list[FloatArray]:
    """Faces of a box standing at `centre` (its footprint's centre and its bottom's height), all but the bottom."""
    R = yaw_rotation(yaw)
    ex, ey, ez = R[:, 0] * size[0], R[:, 1] * size[1], np.array([0, 0, size[2]])
    corner = centre - 0.5 * ex - 0.5 * ey
    faces = [
        (corner, ex, ez),
        (corner + ey, ex, ez),
        (corner, ey, ez),
        (corner + ex, ey, ez),
        (corner + ez, ex, ey),
    ]
    return [_rectangle(rng, c, a, b, density * rng.lognormal(0, 0.6)) for c, a, b in faces]


def make_flat(seed: int) -> Flat:
    """A flat of 2 to 5 rooms along a random layout; every seed is another flat."""
    rng = np.random.default_rng(seed)
    columns = int(rng.integers(1, 4))
    rows = 2 if columns < 3 and rng.random() < 0.6 else 1
    if columns * rows == 1:
        columns = 2
    xs = np.concatenate([[0.0], np.cumsum(rng.uniform(2.6, 5.0, columns))])
    ys = np.concatenate([[0.0], np.cumsum(rng.uniform(2.6, 4.5, rows))])
    height = rng.uniform(2.3, 2.8)
    patches: list[FloatArray] = []
    for i in range(columns):
        for j in range(rows):
            patches += _room(rng, xs[i], xs[i + 1], ys[j], ys[j + 1], height)
    keep = [p for p in patches if len(p)]
    points = np.concatenate(keep)
    patch = np.concatenate([np.full(len(p), k, dtype=np.float64) for k, p in enumerate(keep)])
    return Flat(points, patch, np.array([xs[-1], ys[-1]]))


def _room(rng: np.random.Generator, x0: float, x1: float, y0: float, y1: float, height: float) -> list[FloatArray]:
    out: list[FloatArray] = []
    wall_density = rng.lognormal(np.log(15), 0.8)
    walls = [
        (np.array([x0, y0, 0]), np.array([x1 - x0, 0, 0])),
        (np.array([x0, y1, 0]), np.array([x1 - x0, 0, 0])),
        (np.array([x0, y0, 0]), np.array([0, y1 - y0, 0])),
        (np.array([x1, y0, 0]), np.array([0, y1 - y0, 0])),
    ]
    up = np.array([0, 0, 1.0])
    for corner, along in walls:
        length = float(np.linalg.norm(along))
        direction = along / length
        normal = np.array([direction[1], -direction[0], 0.0])
        inside = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0]) - corner
        normal = normal if normal @ inside > 0 else -normal
        # the wall with a door gap
        door = rng.uniform(0.2, length - 1.1)
        out.append(_rectangle(rng, corner, direction * door, up * height, wall_density))
        out.append(
            _rectangle(
                rng, corner + direction * (door + 0.9), direction * (length - door - 0.9), up * height, wall_density
            )
        )
        for _ in range(rng.integers(0, 4)):  # pictures, calendars
            w, h = rng.uniform(0.2, 0.9, 2)
            s, z = rng.uniform(0.1, max(0.15, length - w)), rng.uniform(0.7, 1.6)
            out.append(_rectangle(rng, corner + direction * s + up * z + normal * 0.02, direction * w, up * h, 400.0))
        if rng.random() < 0.5:  # a shelf or cupboard along the wall
            w, d, h = rng.uniform(0.5, 1.6), rng.uniform(0.25, 0.6), rng.uniform(0.6, 2.1)
            s = rng.uniform(w / 2, max(w / 2 + 0.01, length - w / 2))
            centre = corner + direction * s + normal * (d / 2)
            yaw = float(np.arctan2(direction[1], direction[0]))
            out += _box(rng, centre, np.array([w, d, h]), yaw, rng.lognormal(np.log(120), 0.7))
    out.append(
        _rectangle(rng, np.array([x0, y0, 0]), np.array([x1 - x0, 0, 0]), np.array([0, y1 - y0, 0]), wall_density)
    )
    if rng.random() < 0.6:  # a carpet
        w, h = rng.uniform(0.8, 2.0, 2)
        yaw = rng.uniform(0, np.pi)
        R = yaw_rotation(yaw)
        c = np.array([rng.uniform(x0 + 1, x1 - 1), rng.uniform(y0 + 1, y1 - 1), 0.01])
        out.append(_rectangle(rng, c - R[:, 0] * w / 2 - R[:, 1] * h / 2, R[:, 0] * w, R[:, 1] * h, 150.0))
    for _ in range(rng.integers(2, 6)):  # free-standing furniture
        size = np.array([rng.uniform(0.3, 1.6), rng.uniform(0.3, 0.9), rng.uniform(0.3, 1.2)])
        centre = np.array([rng.uniform(x0 + 0.5, x1 - 0.5), rng.uniform(y0 + 0.5, y1 - 0.5), 0.0])
        yaw = rng.uniform(0, np.pi) if rng.random() < 0.4 else 0.0
        out += _box(rng, centre, size, yaw, rng.lognormal(np.log(100), 0.7))
        for _ in range(rng.integers(0, 4)):  # things on it
            small = rng.uniform(0.08, 0.35, 3)
            offset = np.array([*rng.uniform(-0.3, 0.3, 2) * size[:2], size[2]])
            out += _box(rng, centre + offset, small, rng.uniform(0, np.pi), 500.0)
    return out


def see(
    flat: Flat,
    rng: np.random.Generator,
    region: FloatArray,
    count: int,
    noise_m: float,
    outliers: float,
) -> FloatArray:
    """One drive's cloud: `count` landmarks of the part of the flat where `region` is positive, noise and outliers."""
    num_patches = int(flat.patch.max()) + 1
    visible = rng.random(num_patches) < 0.85
    contrast = rng.lognormal(0, 0.5, num_patches)  # light and distance differ between drives
    patch = flat.patch.astype(np.int64)
    weight = region * visible[patch] * contrast[patch]
    num_true = round(count * (1 - outliers))
    usable = int(np.count_nonzero(weight))
    index = rng.choice(len(weight), size=min(num_true, int(usable * 0.8)), replace=False, p=weight / weight.sum())
    points = flat.points[index] + rng.normal(0, noise_m, (len(index), 3))
    num_false = round(len(index) * outliers / (1 - outliers))
    low, high = points.min(axis=0) - 0.3, points.max(axis=0) + 0.3
    return np.concatenate([points, rng.uniform(low, high, (num_false, 3))])


def _regions(flat: Flat, rng: np.random.Generator, overlap: float) -> tuple[FloatArray, FloatArray]:
    """Target and source regions such that `overlap` of the source's features lie in the target's region."""
    angle = rng.uniform(0, 2 * np.pi)
    along = flat.points[:, :2] @ np.array([np.cos(angle), np.sin(angle)])
    rank = np.argsort(np.argsort(along)) / len(along)
    width = rng.uniform(0.55, 0.8) if overlap < 1 else 1.0
    start = width * (1 - overlap)
    span = width + start  # both regions together
    rank = rank * max(span, 1.0) if span > 1 else rank
    return (rank <= width).astype(np.float64), ((rank >= start) & (rank <= start + width)).astype(np.float64)


def make_pair(
    seed: int,
    *,
    overlap: tuple[float, float] = (0.5, 1.0),
    scale_range: float = 0.0,
    points: tuple[int, int] = (3000, 20000),
    outliers: tuple[float, float] = (0.05, 0.30),
    noise_m: float = 0.02,
    same_flat: bool = True,
    shared_landmarks: bool = True,
    unit_error: tuple[float, float] | None = None,
) -> CloudPair:
    """A random pair; yaw anywhere, translation up to 3 m per axis (1 m vertically), scale within 1 ± scale_range.

    `shared_landmarks` False: the drives share surfaces but not one landmark (two detectors, other light).
    `unit_error`: the source is made too large or too small, by a share between these two.
    """
    rng = np.random.default_rng([seed, 7])
    flat = make_flat(1000 + seed)
    wanted = float(rng.uniform(*overlap))
    region_target, region_source = _regions(flat, rng, wanted)
    if not shared_landmarks:
        mine = rng.random(len(flat.points)) < 0.5
        region_target = region_target * mine
        region_source = region_source * ~mine
    counts = np.exp(rng.uniform(np.log(points[0]), np.log(points[1]), 2)).astype(int)
    target = see(flat, rng, region_target, counts[0], noise_m, rng.uniform(*outliers))
    if same_flat:
        source_flat = flat
    else:
        source_flat = make_flat(500_000 + seed)
        _, region_source = _regions(source_flat, rng, wanted)
    p_source_world = see(source_flat, rng, region_source, counts[1], noise_m, rng.uniform(*outliers))
    scale = float(rng.uniform(1 - scale_range, 1 + scale_range))
    # The source frame: world rotated, moved, and shrunk by 1 / scale.
    R = yaw_rotation(rng.uniform(-np.pi, np.pi))
    t = rng.uniform(-1, 1, 3) * [3.0, 3.0, 1.0]
    origin = np.array([*flat.extent / 2, 1.0])
    T_target_source = se3(scale * R, t)
    source = (p_source_world - origin - t) @ R / scale
    if unit_error is not None:
        factor = 1.0 + float(rng.choice([-1.0, 1.0]) * rng.uniform(*unit_error))
        source *= factor
        T_target_source = se3(scale / factor * R, t)
    return CloudPair(
        target=target - origin,
        source=source,
        T_target_source=T_target_source if same_flat else None,
        overlap=wanted if same_flat else 0.0,
    )


def errors(T: FloatArray | None, T_true: FloatArray | None, at: FloatArray) -> tuple[float, float, float]:
    """How far a registration is off: degrees, distance where a source point (3,) lands, relative scale."""
    assert T is not None and T_true is not None
    turn = so3_log(rotation_of(T) @ rotation_of(T_true).T)
    shift = transform(T - T_true, at)
    growth = abs(scale_of(T) / scale_of(T_true) - 1)
    return float(np.degrees(np.linalg.norm(turn))), float(np.linalg.norm(shift)), growth
