"""What each navigation saw and where it went: its frames, its route with lengths, its coloured cloud."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from shared.geometry import FloatArray
from station.experiments.plotting import FIRST, SECOND, decode_rgb, frame, without_axes
from station.experiments.routes import Route, find_sections
from station.experiments.scene import DrivenPath, Scene
from station.model.navigation import Navigation

NAMES = ("Navigation1", "Navigation2")
MOMENTS = ("first frame", "early middle frame", "late middle frame", "last frame")
NIGHT = "#12151B"  # behind coloured clouds: white walls are seen, and so is dark wood
ELEVATION_RAD = np.radians(35.0)
PANEL_ASPECT = 1.3  # width by height of a picture of a cloud
EYE_DISTANCE = 3.5  # of the cloud's radius
NEAREST_SHARE = 0.6  # of that distance: nearer points would fill the picture


def draw_frames(scene: Scene) -> Figure:
    """Four pictures of each navigation (fig. 5.1)."""
    figure, rows = plt.subplots(2, len(MOMENTS), figsize=(11, 4.6), layout="constrained")
    for row, name, navigation in zip(rows, NAMES, (scene.first, scene.second), strict=True):
        row[0].set_ylabel(name, fontweight="bold", color="#111827")
        _draw_moments(row, navigation)
    for ax, moment in zip(rows[0], MOMENTS, strict=True):
        ax.set_title(moment, fontweight="normal")
    return figure


def _draw_moments(row: list[Axes], navigation: Navigation) -> None:
    for ax in row:
        without_axes(ax)
    keyframes = navigation.keyframes
    if not len(keyframes):
        return
    for ax, k in zip(row, np.linspace(0, len(keyframes) - 1, len(MOMENTS)).round().astype(int), strict=True):
        picture = decode_rgb(keyframes.encoded[k])
        if picture is not None:
            ax.imshow(picture)
        ax.set_xlabel(f"{(keyframes.t_robot_ns[k] - keyframes.t_robot_ns[0]) / 1e9:.1f} s")


def draw_routes(scene: Scene) -> Figure | None:
    """The route of each navigation from above, with the lengths of its sections (figs. 5.6, 5.9)."""
    paths = scene.driven_paths()
    if paths is None:
        return None
    figure, axes = plt.subplots(1, 2, figsize=(11, 5.2))
    for ax, name, colour, path in zip(axes, NAMES, (FIRST, SECOND), paths, strict=True):
        route = find_sections(path.position[:, :2])
        _draw_route(ax, route, colour, path.unit)
        frame(ax, _limits_of_paths(path, paths), (0, 1), path.unit)
        ax.set_title(f"{name}: {route.length.sum():.2f} {path.unit} from above, {path.source}")
    figure.tight_layout(w_pad=2.0)
    return figure


def _limits_of_paths(path: DrivenPath, paths: tuple[DrivenPath, DrivenPath]) -> tuple[FloatArray, FloatArray]:
    """Room for the labels; the same window for both where both are in one frame."""
    p = np.concatenate([other.position for other in paths]) if path.is_shared_frame else path.position
    low, high = p.min(axis=0), p.max(axis=0)
    margin = 0.2 * float((high - low).max()) + 1e-6
    return low - margin, high + margin


def _draw_route(ax: Axes, route: Route, colour: str, unit: str) -> None:
    path = route.path
    ax.plot(path[:, 0], path[:, 1], c=colour, lw=2.2, solid_capstyle="round", zorder=3)
    if len(route.length) > 1:
        _draw_sections(ax, route, colour, unit)
    else:
        _draw_marks(ax, route, colour, unit)
    start, end = path[0], path[-1]
    ax.scatter(start[0], start[1], s=60, c="white", edgecolors=colour, linewidths=2, zorder=6, label="start")
    ax.scatter(end[0], end[1], s=60, marker="s", c=colour, edgecolors="white", linewidths=1.2, zorder=6, label="end")
    ax.legend(loc="upper right", fontsize=8)


def _draw_sections(ax: Axes, route: Route, colour: str, unit: str) -> None:
    """The length of each section, and the angle between two."""
    corner, centre = route.path[route.corner], route.path.mean(axis=0)
    ax.plot(corner[:, 0], corner[:, 1], c="#9AA3AF", lw=0.9, ls="--", zorder=2)
    for k, length in enumerate(route.length):
        section = route.path[route.corner[k] : route.corner[k + 1] + 1]
        _draw_arrow(ax, section, colour)
        middle = section[len(section) // 2]
        _write(ax, middle, _away(corner[k + 1] - corner[k], middle - centre), f"{length:.2f} {unit}")
    for at, turn in zip(corner[1:-1], route.turn_deg, strict=True):
        ax.annotate(f"{180 - abs(turn):.0f}°", _xy(at), fontsize=8, color="#4B5563", ha="center", va="center", zorder=5,
                    bbox={"boxstyle": "circle,pad=0.15", "fc": "white", "ec": "#9AA3AF", "lw": 0.8})  # fmt: skip


def _draw_marks(ax: Axes, route: Route, colour: str, unit: str) -> None:
    """Round distances along a path that winds."""
    centre = route.path.mean(axis=0)
    for distance, at in zip(*route.marks(), strict=True):
        row = int(np.searchsorted(route.driven, distance))
        _draw_arrow(ax, route.path[max(row - 2, 0) : row + 2], colour)
        _write(ax, at, _away(route.path[row] - route.path[row - 1], at - centre), f"{distance:g} {unit}")


def _away(along: FloatArray, outwards: FloatArray) -> FloatArray:
    """(2,) unit vector across a direction, to the side of the route's outside."""
    normal = np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 1e-12)
    return normal if normal @ outwards >= 0 else -normal


def _write(ax: Axes, at: FloatArray, away: FloatArray, text: str) -> None:
    """A label beside a point of the route."""
    ax.annotate(text, _xy(at), _xy(24 * away), textcoords="offset points", ha="center", va="center", fontsize=8.5,
                fontweight="bold", color="#111827", zorder=7,
                bbox={"boxstyle": "round,pad=0.2", "fc": "white", "ec": "none", "alpha": 0.85})  # fmt: skip


def _draw_arrow(ax: Axes, section: FloatArray, colour: str) -> None:
    """An arrow in the middle of a section, along the way it was driven."""
    middle = len(section) // 2
    if middle >= 1:
        ax.annotate("", _xy(section[middle]), _xy(section[middle - 1]), zorder=4,
                    arrowprops={"arrowstyle": "-|>", "color": colour, "mutation_scale": 18, "lw": 0})  # fmt: skip


def _xy(p: FloatArray) -> tuple[float, float]:
    return float(p[0]), float(p[1])


def draw_coloured_clouds(scene: Scene) -> Figure:
    """Both clouds in their landmarks' colours, seen from one side where they are registered (figs. 5.7, 5.10 a, b)."""
    second = scene.p_second if scene.T is None else scene.carried(scene.second.landmarks.p_world)
    clouds = (scene.p_first, second)
    view = Viewpoint.of(scene.p_first, _cameras(scene.first, scene.R_first))
    views = [view, view if scene.T is not None else Viewpoint.of(second, _cameras(scene.second, scene.R_second))]
    seen = [view.project(p) for view, p in zip(views, clouds, strict=True)]
    windows = [_window(seen if scene.T is not None else [one]) for one in seen]
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.6))
    for k, (ax, navigation) in enumerate(zip(axes, (scene.first, scene.second), strict=True)):
        without_axes(ax)
        ax.set_facecolor(NIGHT)
        ax.set_title(f"{NAMES[k]}: {len(navigation.landmarks):,} landmarks")
        _draw_cloud(ax, seen[k], navigation.landmarks.rgb / 255.0, windows[k])
    figure.tight_layout(w_pad=1.5)
    return figure


def _cameras(navigation: Navigation, R_drawn_world: FloatArray) -> FloatArray:
    """(F, 3) where the pictures were taken, in axes whose z is up."""
    return navigation.keyframes.T_world_cam[:, :3, 3] @ R_drawn_world.T


def _draw_cloud(ax: Axes, seen: FloatArray, rgb: FloatArray, window: FloatArray) -> None:
    """Projected points, the farthest first; nearer ones are larger."""
    shown = np.flatnonzero(np.isfinite(seen[:, 2]))
    shown = shown[np.argsort(seen[shown, 2])]
    x, y, nearness = seen[shown].T
    ax.scatter(x, y, s=9.0 * nearness**2, c=rgb[shown], linewidths=0)
    ax.set_xlim(window[0, 0], window[1, 0])
    ax.set_ylim(window[0, 1], window[1, 1])
    ax.set_aspect("equal", adjustable="box")


def _window(seen: Sequence[FloatArray]) -> FloatArray:
    """(2, 2) corners of a picture that holds nearly all projected points."""
    xy = np.concatenate([p[np.isfinite(p[:, 2]), :2] for p in seen])
    low, high = np.percentile(xy, [0.5, 99.5], axis=0) if len(xy) else np.array([[-1.0, -1.0], [1.0, 1.0]])
    half_height = 0.55 * max((high[0] - low[0]) / PANEL_ASPECT, high[1] - low[1], 1e-6)
    half = half_height * np.array([PANEL_ASPECT, 1.0])
    return np.array([(low + high) / 2 - half, (low + high) / 2 + half])


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoint:
    """Where a cloud whose z is up is looked at from: the cameras' side, slightly above, its longer side across."""

    R_eye_cloud: FloatArray  # (3, 3); x to the right, y up, z towards the eye
    centre: FloatArray  # (3,)
    radius: float  # that holds nearly all of it

    @classmethod
    def of(cls, p: FloatArray, cameras: FloatArray) -> Viewpoint:
        """For a cloud (N, 3) that was seen from (F, 3)."""
        p = p[np.isfinite(p).all(axis=1)]
        if len(p) < 3:
            return cls(np.eye(3), np.zeros(3), 1.0)
        low, high = np.percentile(p, [2, 98], axis=0)
        inside = np.clip(p, low, high)  # far stragglers count like the edge
        centre = (low + high) / 2
        right = np.append(np.linalg.eigh(np.cov(inside[:, :2].T))[1][:, 1], 0.0)
        up = np.array([0.0, 0.0, 1.0])
        if len(cameras) and np.cross(right, up) @ (cameras.mean(axis=0) - inside.mean(axis=0)) < 0:
            right = -right
        towards = np.cos(ELEVATION_RAD) * np.cross(right, up) + np.sin(ELEVATION_RAD) * up
        radius = max(float(np.linalg.norm(inside - centre, axis=1).max()), 1e-9)
        return cls(np.stack([right, np.cross(towards, right), towards]), centre, radius)

    def project(self, p: FloatArray) -> FloatArray:
        """(N, 3) where points (N, 3) fall in the picture, and how large things are there; NaN behind the eye."""
        q = (p - self.centre) @ self.R_eye_cloud.T / self.radius
        depth = np.where(q[:, 2] < NEAREST_SHARE * EYE_DISTANCE, EYE_DISTANCE - q[:, 2], np.nan)
        nearness = EYE_DISTANCE / depth
        return np.column_stack([q[:, :2] * nearness[:, None], nearness])
