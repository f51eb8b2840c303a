"""The figures of chapter 5 and appendix A."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from shared.geometry import FloatArray
from station.experiments.experiment import Experiment
from station.experiments.navigation_figures import draw_coloured_clouds, draw_frames, draw_routes
from station.experiments.plotting import (
    FIRST,
    NOISE_COLOUR,
    RIGHT,
    SECOND,
    STYLE,
    VIEWS,
    WRONG,
    decode_rgb,
    frame,
    label,
    legend_below,
    limits,
    short,
    without_axes,
)
from station.experiments.scene import Scene, unit_of
from station.model.navigation import Navigation
from station.model.place_map import Place
from station.places.making.clusters import centre_and_normalise
from station.places.making.place_images import PlaceImages, keyframes_of_place, make_place_images


def draw_figures(experiment: Experiment, folder: Path) -> dict[str, Path]:
    """Write every figure; returns their files by what they show."""
    folder.mkdir(parents=True, exist_ok=True)
    scene = Scene(experiment)
    files: dict[str, Path] = {}
    with plt.rc_context(STYLE):
        for name, draw in (
            ("frames", draw_frames),
            ("routes", draw_routes),
            ("coloured_clouds", draw_coloured_clouds),
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
    window = limits(clouds)
    for ax, (view, (i, j)) in zip(axes, VIEWS.items(), strict=True):
        for p, colour, name in zip(clouds, (FIRST, SECOND), ("Navigation1", "Navigation2"), strict=True):
            ax.scatter(p[:, i], p[:, j], s=2.5, c=colour, alpha=0.55, linewidths=0, label=f"{name} ({len(p):,})")
        frame(ax, window, (i, j), unit)
        ax.set_title(f"{title}, from {view}" if view == "above" else f"{title}, from the front")
    legend_below(figure, axes[0], markerscale=4)
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
            label(ax, (R @ cluster.centroid_map)[[i, j]], short(cluster), colour[cluster.id])
        frame(ax, limits([p]), (i, j), scene.unit if title == "Navigation1" else unit_of(scene.second))
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
        label(ax, (scene.R_first @ place.centroid_map)[:2], short(place), scene.place_colour[place.id])
    frame(ax, limits([scene.p_first, p]), (0, 1), scene.unit)
    n, locations = len(scene.experiment.result.matches), len(scene.locations)
    ax.set_title(f"{n} matches of {len(scene.places)} places and {locations} locations, from above")
    ax.plot([], [], c=RIGHT if scene.correct else "#111827", lw=2.5, marker="D", mfc="white",
            label="match: place (number) to location (diamond)")  # fmt: skip
    if scene.correct:
        ax.plot([], [], c=WRONG, lw=2.5, label="wrong by the recorded poses")
    legend_below(figure, ax)
    return figure


def draw_trajectories(scene: Scene) -> Figure:
    """Each trajectory among the map's places: Navigation1's, and Navigation2's carried into the map (fig. 5.4)."""
    t_first = scene.first.trajectory.T_world_body[:, :3, 3] @ scene.R_first.T
    t_second = scene.experiment.result.position_map @ scene.R_first.T
    window = _holding(limits([scene.p_first]), np.concatenate([t_first, t_second]))
    figure, axes = plt.subplots(
        1, 2 if len(t_second) else 1, figsize=(11 if len(t_second) else 6.5, 5.6), squeeze=False
    )
    for ax in axes[0]:
        _draw_places(ax, scene)
        frame(ax, window, (0, 1), scene.unit)
    left = axes[0, 0]
    left.plot(t_first[:, 0], t_first[:, 1], c=FIRST, lw=1.8, zorder=3, label="Navigation1's trajectory")
    _draw_edges(left, scene)
    left.set_title("Navigation1 among its places")
    handles, labels = left.get_legend_handles_labels()
    if len(t_second):
        right = axes[0, 1]
        right.plot(
            t_second[:, 0], t_second[:, 1], c=SECOND, lw=1.4, zorder=3, label="Navigation2's, carried into the map"
        )
        _draw_nearest_places(right, scene, t_second)
        right.set_title("Navigation2 among Navigation1's places")
        more = right.get_legend_handles_labels()
        handles, labels = handles + more[0], labels + more[1]
    figure.tight_layout(w_pad=2.0)
    figure.legend(handles, labels, loc="upper center", bbox_to_anchor=(0.5, 0.02), ncols=3, columnspacing=1.6)
    return figure


def _holding(window: tuple[FloatArray, FloatArray], path: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A window with all of a path in it, however far from the cloud a wrong registration puts that."""
    if not len(path):
        return window
    margin = 0.05 * np.ptp(path, axis=0).max()
    return np.minimum(window[0], path.min(axis=0) - margin), np.maximum(window[1], path.max(axis=0) + margin)


def _draw_places(ax: Axes, scene: Scene) -> None:
    for place in scene.places:
        q = scene.p_first[place.landmark_index]
        ax.scatter(q[:, 0], q[:, 1], s=4, c=scene.place_colour[place.id], alpha=0.35, linewidths=0)
    for place in scene.places:
        label(ax, (scene.R_first @ place.centroid_map)[:2], short(place), scene.place_colour[place.id])


def _draw_edges(ax: Axes, scene: Scene) -> None:
    styles = {"seen together": "-", "driven between": "--", "nearest": ":"}
    for edge in scene.experiment.place_map.edges:
        a, b = (scene.R_first @ scene.place_of[end].centroid_map for end in (edge.a, edge.b))
        ax.plot([a[0], b[0]], [a[1], b[1]], c="#6B7280", lw=0.9, ls=styles[edge.kind], zorder=2)
    for name, style in styles.items():
        ax.plot([], [], c="#6B7280", lw=0.9, ls=style, label=f"edge: {name}")


def _draw_nearest_places(ax: Axes, scene: Scene, position: FloatArray) -> None:
    nearest = scene.experiment.result.nearest_place
    if len(nearest):
        colours = [scene.place_colour[scene.places[k].id] for k in nearest]
        ax.scatter(position[:, 0], position[:, 1], s=22, c=colours, edgecolors="white", linewidths=0.6, zorder=4,
                   label="its nearest place, by colour")  # fmt: skip


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
        without_axes(ax)
    if images.representative_keyframe >= 0:
        representative = decode_rgb(navigation.keyframes.encoded[images.representative_keyframe])
        assert representative is not None  # it was decoded before
        row[0].imshow(representative)
        row[1].imshow(images.mean_bgr[..., ::-1])
        row[2].imshow(images.deviation, cmap="magma", vmin=0, vmax=100)


def _place_images(navigation: Navigation, clusters: Sequence[Place], thesis: bool) -> dict[str, PlaceImages]:
    chosen = {c.id: keyframes_of_place(navigation.landmarks, c.landmark_index, thesis=thesis) for c in clusters}
    return make_place_images(navigation.keyframes, chosen)
