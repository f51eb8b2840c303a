"""The figures of chapter 5 and appendix A."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl

mpl.use("Agg")  # files only: no display is needed, and none is opened

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from shared.geometry import FloatArray, transform
from station.experiments.experiment import Experiment
from station.model.navigation import Navigation
from station.model.place_map import Place
from station.places.making.clusters import centre_and_normalise
from station.places.making.place_images import PlaceImages, keyframes_of_place, make_place_images
from station.places.making.scale import ground_rotation

# Okabe and Ito's colours first: told apart by colour-blind readers, too; then as many as a flat may need.
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#8C6BB1", "#B8A800",
           "#7F3B08", "#1B7837", "#A50026", "#4575B4", "#F768A1", "#525252", "#66C2A4", "#FC8D62")  # fmt: skip
FIRST, SECOND, NOISE_COLOUR, RIGHT, WRONG = "#1F4E9E", "#D1382C", "#C9CDD3", "#1B8A4B", "#C62828"
STYLE: dict[Any, Any] = {  # Any: the library lists every key as a literal
    "font.family": "DejaVu Sans", "font.size": 9, "axes.titlesize": 10, "axes.titleweight": "bold",
    "axes.edgecolor": "#9AA3AF", "axes.labelcolor": "#374151", "xtick.color": "#6B7280", "ytick.color": "#6B7280",
    "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.color": "#EEF0F3",
    "axes.axisbelow": True, "legend.frameon": False, "figure.dpi": 110, "savefig.bbox": "tight",
}  # fmt: skip
VIEWS = {"above": (0, 1), "in front": (0, 2)}


def draw_figures(experiment: Experiment, folder: Path) -> dict[str, Path]:
    """Write every figure; returns their files by what they show."""
    folder.mkdir(parents=True, exist_ok=True)
    scene = Scene(experiment)
    files: dict[str, Path] = {}
    with plt.rc_context(STYLE):
        for name, draw in (
            ("clouds_before", draw_clouds_before),
            ("clouds_after", draw_clouds_after),
            ("clusters_above", lambda s: draw_clusters(s, "above")),
            ("clusters_in_front", lambda s: draw_clusters(s, "in front")),
            ("matches", draw_matches),
            ("trajectories", draw_trajectories),
        ):
            if (figure := draw(scene)) is not None:
                files[name] = save_figure(figure, folder / f"{name}.png")
        for name, figure in draw_match_images(scene):
            files[name] = save_figure(figure, folder / f"{name}.png")
    return files


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a figure, and free what it took."""
    figure.savefig(path)
    plt.close(figure)
    return path


class Scene:
    """Clouds and clusters of both navigations in axes whose z is up, and their colours."""

    def __init__(self, experiment: Experiment) -> None:
        self.experiment = experiment
        self.first, self.second = experiment.place_map.navigation, experiment.navigation
        self.places, self.locations = experiment.place_map.places, experiment.result.locations
        self.place_of = {place.id: place for place in self.places}
        self.location_of = {location.id: location for location in self.locations}
        self.R_first, self.R_second = ground_rotation(self.first), ground_rotation(self.second)
        self.T = experiment.result.registration.T_target_source
        self.unit = "m" if self.first.is_metric else "map units"
        self.p_first = self.first.landmarks.p_world @ self.R_first.T
        self.p_second = self.second.landmarks.p_world @ self.R_second.T
        self.place_colour = {p.id: COLOURS[k % len(COLOURS)] for k, p in enumerate(self.places)}
        matched = {m.location_id: self.place_colour[m.place_id] for m in experiment.result.matches}
        # A location without a match keeps a colour of its own, from the other end of the list.
        spare = [c for c in reversed(COLOURS) if c not in matched.values()] or list(COLOURS)
        self.location_colour = {
            p.id: matched.get(p.id, spare[k % len(spare)]) for k, p in enumerate(self.locations)
        }  # fmt: skip
        judgement = experiment.judgement
        self.correct = {j.match.place_id: j.correct for j in judgement.judged} if judgement else {}

    def carried(self, p: FloatArray) -> FloatArray:
        """Points of Navigation2's frame in the drawn axes of the map."""
        assert self.T is not None
        return transform(self.T, p) @ self.R_first.T


def draw_clouds_before(scene: Scene) -> Figure:
    """Both clouds before registration, centred and normalised where a scale is arbitrary (fig. 5.7 c, left)."""
    clouds = [scene.p_first, scene.p_second]
    unit = scene.unit
    if not (scene.first.is_metric and scene.second.is_metric):
        clouds = [centre_and_normalise(p[np.isfinite(p).all(axis=1)])[0] if len(p) else p for p in clouds]
        unit = "normalised"
    return _two_clouds(clouds, "before registration", unit)


def draw_clouds_after(scene: Scene) -> Figure | None:
    """Both clouds after registration (fig. 5.7 c, right; fig. A.1)."""
    if scene.T is None:
        return None
    accepted = scene.experiment.result.registration.accepted
    title = "after registration" if accepted else "best alignment found, refused"
    return _two_clouds([scene.p_first, scene.carried(scene.second.landmarks.p_world)], title, scene.unit)


def _two_clouds(clouds: Sequence[FloatArray], title: str, unit: str) -> Figure:
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.8))
    limits = _limits(clouds)
    for ax, (view, (i, j)) in zip(axes, VIEWS.items(), strict=True):
        for p, colour, name in zip(clouds, (FIRST, SECOND), ("Navigation1", "Navigation2"), strict=True):
            ax.scatter(p[:, i], p[:, j], s=2.5, c=colour, alpha=0.55, linewidths=0, label=f"{name} ({len(p):,})")
        _frame(ax, limits, (i, j), unit)
        ax.set_title(f"{title}, from {view}" if view == "above" else f"{title}, from the front")
    _legend_below(figure, axes[0], markerscale=4)
    return figure


def draw_clusters(scene: Scene, view: str) -> Figure:
    """The clusters of both navigations, each in its own frame (figs. A.2, A.4, A.6)."""
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.8))
    i, j = VIEWS[view]
    panels = (
        ("Navigation1", "places", scene.p_first, scene.places, scene.place_colour, scene.R_first),
        ("Navigation2", "locations", scene.p_second, scene.locations, scene.location_colour, scene.R_second),
    )
    for ax, (title, word, p, clusters, colour, R) in zip(axes, panels, strict=True):
        ax.scatter(p[:, i], p[:, j], s=2, c=NOISE_COLOUR, linewidths=0)
        for cluster in clusters:
            q = p[cluster.landmark_index]
            ax.scatter(q[:, i], q[:, j], s=4, c=colour[cluster.id], alpha=0.8, linewidths=0)
        for cluster in clusters:
            _label(ax, (R @ cluster.centroid_map)[[i, j]], _short(cluster), colour[cluster.id])
        _frame(ax, _limits([p]), (i, j), scene.unit if title == "Navigation1" else _unit(scene.second))
        ax.set_title(f"{title}: {len(clusters)} {word}, from {'above' if view == 'above' else 'the front'}")
    return figure


def draw_matches(scene: Scene) -> Figure | None:
    """Places and the locations matched with them, in the map (figs. 5.5, 5.8, 5.11)."""
    if scene.T is None:
        return None
    figure, ax = plt.subplots(figsize=(8.5, 6.5))
    p = scene.carried(scene.second.landmarks.p_world)
    ax.scatter(scene.p_first[:, 0], scene.p_first[:, 1], s=2, c=NOISE_COLOUR, linewidths=0)
    for place in scene.places:
        q = scene.p_first[place.landmark_index]
        ax.scatter(q[:, 0], q[:, 1], s=5, c=scene.place_colour[place.id], alpha=0.45, linewidths=0)
    for location in scene.locations:
        q = p[location.landmark_index]
        ax.scatter(q[:, 0], q[:, 1], s=5, facecolors="none", edgecolors=scene.location_colour[location.id],
                   linewidths=0.5, alpha=0.7, marker="D")  # fmt: skip
    for match in scene.experiment.result.matches:
        a = (scene.R_first @ scene.place_of[match.place_id].centroid_map)[:2]
        b = scene.carried(scene.location_of[match.location_id].centroid_map[None])[0, :2]
        right = scene.correct.get(match.place_id)
        colour = "#111827" if right is None else RIGHT if right else WRONG
        ax.plot([a[0], b[0]], [a[1], b[1]], c=colour, lw=2.5, zorder=4)
        ax.scatter(b[0], b[1], s=50, marker="D", c="white", edgecolors=colour, linewidths=1.8, zorder=5)
    for place in scene.places:
        _label(ax, (scene.R_first @ place.centroid_map)[:2], _short(place), scene.place_colour[place.id])
    _frame(ax, _limits([scene.p_first, p]), (0, 1), scene.unit)
    n, locations = len(scene.experiment.result.matches), len(scene.locations)
    ax.set_title(f"{n} matches of {len(scene.places)} places and {locations} locations, from above")
    ax.plot([], [], c=RIGHT if scene.correct else "#111827", lw=2.5, marker="D", mfc="white",
            label="match: place (number) to location (diamond)")  # fmt: skip
    if scene.correct:
        ax.plot([], [], c=WRONG, lw=2.5, label="wrong by the recorded poses")
    _legend_below(figure, ax)
    return figure


def draw_trajectories(scene: Scene) -> Figure | None:
    """Where both navigations drove, among the places; Navigation2 coloured by the nearest place (fig. 5.4)."""
    figure, ax = plt.subplots(figsize=(8.5, 6.5))
    for place in scene.places:
        q = scene.p_first[place.landmark_index]
        ax.scatter(q[:, 0], q[:, 1], s=4, c=scene.place_colour[place.id], alpha=0.35, linewidths=0)
    centroid = {place.id: (scene.R_first @ place.centroid_map)[:2] for place in scene.places}
    for edge in scene.experiment.place_map.edges:
        a, b = centroid[edge.a], centroid[edge.b]
        style = {"seen together": "-", "driven between": "--", "nearest": ":"}[edge.kind]
        ax.plot([a[0], b[0]], [a[1], b[1]], c="#6B7280", lw=0.9, ls=style, zorder=2)
    t = scene.first.trajectory.T_world_body[:, :3, 3] @ scene.R_first.T
    ax.plot(t[:, 0], t[:, 1], c=FIRST, lw=1.6, label="Navigation1's trajectory")
    extent = [scene.p_first, t]
    position = scene.experiment.result.position_map
    if len(position):
        q = position @ scene.R_first.T
        ax.plot(q[:, 0], q[:, 1], c=SECOND, lw=1.2, label="Navigation2's, carried into the map")
        nearest = scene.experiment.result.nearest_place
        if len(nearest):
            ids = [scene.places[k].id for k in nearest]
            ax.scatter(q[:, 0], q[:, 1], s=22, c=[scene.place_colour[i] for i in ids], edgecolors="white",
                       linewidths=0.6, zorder=4, label="its nearest place, by colour")  # fmt: skip
        extent.append(q)
    for place in scene.places:
        _label(ax, centroid[place.id], _short(place), scene.place_colour[place.id])
    for name, style in (("seen together", "-"), ("driven between", "--"), ("nearest", ":")):
        ax.plot([], [], c="#6B7280", lw=0.9, ls=style, label=f"edge: {name}")
    _frame(ax, _limits(extent), (0, 1), scene.unit)
    ax.set_title("place graph and trajectories, from above")
    _legend_below(figure, ax)
    return figure


def draw_match_images(scene: Scene) -> Iterator[tuple[str, Figure]]:
    """Per match: representative image, mean image and brightness deviation of both sides (figs. A.3, A.5, A.7)."""
    matches = scene.experiment.result.matches
    thesis = scene.experiment.config.mode == "thesis"
    first = _place_images(scene.first, [scene.place_of[m.place_id] for m in matches], thesis)
    second = _place_images(scene.second, [scene.location_of[m.location_id] for m in matches], thesis)
    for number, match in enumerate(matches, start=1):
        place, location = scene.place_of[match.place_id], scene.location_of[match.location_id]
        figure, axes = plt.subplots(2, 3, figsize=(10, 5.4))
        rows = ((place.name, scene.first, first[place.id]), (location.name, scene.second, second[location.id]))
        for row, (name, navigation, images) in zip(axes, rows, strict=True):
            _draw_images_row(row, name, navigation, images)
        figure.tight_layout(h_pad=1.8)
        yield f"match_{number:02d}", figure


def _draw_images_row(row: Sequence[Axes], name: str, navigation: Navigation, images: PlaceImages) -> None:
    titles = (
        f"{name}: representative",
        f"mean of {len(images.keyframe_index)} images",
        f"brightness deviation, mean {images.mean_deviation:.0f}",
    )
    for ax, title in zip(row, titles, strict=True):
        ax.set_title(title)
        ax.set_xticks([])
        ax.set_yticks([])
        ax.grid(visible=False)
        ax.set_facecolor("#F3F4F6")
    if images.representative_keyframe >= 0:
        row[0].imshow(decode_rgb(navigation.keyframes.encoded[images.representative_keyframe]))
        row[1].imshow(images.mean_bgr[..., ::-1])
        row[2].imshow(images.deviation, cmap="magma", vmin=0, vmax=100)


def decode_rgb(encoded: bytes) -> np.typing.NDArray[np.uint8]:
    """(H, W, 3) pixels of a JPEG or PNG that was decoded before."""
    image = cv2.imdecode(np.frombuffer(encoded, dtype=np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return np.asarray(image[..., ::-1], dtype=np.uint8)


def _place_images(navigation: Navigation, clusters: Sequence[Place], thesis: bool) -> dict[str, PlaceImages]:
    chosen = {c.id: keyframes_of_place(navigation.landmarks, c.landmark_index, thesis=thesis) for c in clusters}
    return make_place_images(navigation.keyframes, chosen)


def _unit(navigation: Navigation) -> str:
    return "m" if navigation.is_metric else "its own units"


def _short(place: Place) -> str:
    """The number of a place that was named by number; else its name."""
    tail = place.name.rpartition(" ")[2]
    return tail if tail.isdecimal() else place.name


def _limits(clouds: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Corners that hold nearly all points: single far outliers must not shrink the rest to a dot."""
    p = np.concatenate([c[np.isfinite(c).all(axis=1)] for c in clouds])
    if not len(p):
        return np.full(3, -1.0), np.full(3, 1.0)
    low, high = np.percentile(p, 1, axis=0), np.percentile(p, 99, axis=0)
    margin = 0.08 * float((high - low).max()) + 1e-6
    return low - margin, high + margin


def _frame(ax: Axes, limits: tuple[FloatArray, FloatArray], axes: tuple[int, int], unit: str) -> None:
    i, j = axes
    ax.set_xlim(limits[0][i], limits[1][i])
    ax.set_ylim(limits[0][j], limits[1][j])
    ax.set_aspect("equal", adjustable="box")
    ax.set_xlabel(f"{'xyz'[i]} ({unit})")
    ax.set_ylabel(f"{'xyz'[j]} ({unit})")


def _legend_below(figure: Figure, ax: Axes, markerscale: float = 1.0) -> None:
    figure.legend(*ax.get_legend_handles_labels(), loc="upper center", bbox_to_anchor=(0.5, 0.02), ncols=3,
                  markerscale=markerscale, columnspacing=1.6)  # fmt: skip


def _label(ax: Axes, at: FloatArray, text: str, colour: str) -> None:
    ax.annotate(
        text, (float(at[0]), float(at[1])), ha="center", va="center", fontsize=8, fontweight="bold", color="white",
        bbox={"boxstyle": "round,pad=0.25", "fc": colour, "ec": "white", "lw": 1.0}, zorder=6, annotation_clip=True,
    )  # fmt: skip
