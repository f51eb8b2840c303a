"""What an experiment leaves behind: results.json, figures, and report.html, one page with all of it."""

from __future__ import annotations

import base64
import json
import math
import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2

from shared.errors import DataError
from station.experiments.experiment import Experiment, registers_normalised, results_dict
from station.experiments.figures import draw_figures
from station.experiments.scene import unit_of
from station.places.making.repeatability import repeatability
from station.places.registration.result import uncertainty_of

FIGURES = (
    ("frames", "What the cameras saw", "Four moments of each navigation (thesis: fig. 5.1)."),
    ("routes", "Routes and their lengths",
     "Where the robot went, how long each straight section is, and the angle between two of them (figs. 5.6, 5.9)."),
    ("coloured_clouds", "Coloured point clouds",
     "Each landmark in the colour it was seen in (figs. 5.7 a and b, 5.10 a and b)."),
    ("clouds_before", "Point clouds before registration",
     "Navigation1 in blue, Navigation2 in red (figs. 5.7 c, 5.10 c, A.1)."),
    ("clouds_after", "Point clouds after registration", "Where they coincide, blue and red mix."),
    ("clusters_above", "Clusters, from above", "One colour per cluster; grey landmarks belong to none (fig. A.2)."),
    ("clusters_in_front", "Clusters, from the front", "(figs. A.4, A.6)"),
    ("matches", "Matches", "Each location of Navigation2 and the place it was matched with (figs. 5.5, 5.8, 5.11)."),
    ("trajectories", "Trajectories among the places",
     "On the left the place graph and Navigation1; on the right Navigation2, each pose in the colour of the place "
     "that is nearest (fig. 5.4)."),
)  # fmt: skip


def write_experiment(experiment: Experiment, out: Path) -> None:
    """Write an experiment's files into `out`, replacing those of an earlier run and touching nothing else there.

    Raises:
        DataError: the folder cannot be written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=".new-", dir=out))
        try:
            figures = draw_figures(experiment, scratch / "figures")
            write_report(experiment, figures, scratch / "report.html")
            text = json.dumps(results_dict(experiment), indent=1, default=str) + "\n"
            (scratch / "results.json").write_text(text, encoding="utf-8")
            if (out / "figures").exists():
                os.rename(out / "figures", scratch / "old-figures")
            for name in ("figures", "report.html", "results.json"):
                os.replace(scratch / name, out / name)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    except OSError as exc:
        raise DataError(f"{out} cannot be written ({exc.strerror}); free space or choose another folder") from exc


def write_report(experiment: Experiment, figures: Mapping[str, Path], path: Path) -> None:
    """Write the page; images are inside it, so that it can be sent as one file."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=jinja2.StrictUndefined
    )
    environment.filters["number"] = _number
    page = environment.get_template("report.html.j2").render(**_content(experiment, figures))
    path.write_text(page, encoding="utf-8")


def _content(experiment: Experiment, figures: Mapping[str, Path]) -> dict[str, Any]:
    results = results_dict(experiment)
    first, second = experiment.place_map.navigation, experiment.navigation
    of_matches = {name: _data_uri(path) for name, path in figures.items() if name.startswith("match_")}
    return {
        "story": experiment.story,
        "results": results,
        "verdict": _verdict(results),
        "navigations": {"Navigation1": first, "Navigation2": second},
        "figures": [
            {"title": title, "caption": caption, "image": _data_uri(figures[name])}
            for name, title, caption in FIGURES
            if name in figures
        ],
        "matches": [
            {**match, "image": of_matches.get(f"match_{number:02d}")}
            for number, match in enumerate(results["matches"], start=1)
        ],
        "places": [
            {"place": place, "repeatability": share, "found_again": experiment.found_again(place.id)}
            for place, share in zip(
                experiment.place_map.places, repeatability(experiment.place_map).tolist(), strict=True
            )
        ],
        "uncertainty": _uncertainty(experiment),
        "edges": len(experiment.place_map.edges),
        "comparison": _comparison(experiment, results),
        "config": json.dumps(results["config"], indent=2, default=str),
        "unit": unit_of(first),
        "rmse_unit": _rmse_unit(experiment),
    }


def _verdict(results: Mapping[str, Any]) -> tuple[str, str]:
    """(good | bad | neutral, one sentence)."""
    n = len(results["matches"])
    if not results["registration"]["accepted"]:
        return "neutral", "The clouds could not be registered with certainty, so no place was matched."
    if not results["places"]:
        return "neutral", "The map holds no place, so there was nothing to match with."
    if not n:
        return "neutral", "The clouds were registered, but no location was matched with a place."
    if results["truth"] == "none":
        return "neutral", f"{n} matches; without recorded poses nobody but you can judge them."
    right = sum(bool(match["correct"]) for match in results["matches"])
    kind = "good" if right == n else "bad"
    return kind, f"{right} of {n} matches are right by the recorded poses."


def _comparison(experiment: Experiment, results: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Column title → what is compared → its value; empty for an experiment that the thesis did not make."""
    if not experiment.story.thesis:
        return {}
    columns = {"the thesis": dict(experiment.story.thesis)}
    if experiment.as_thesis is not None:
        columns["its settings, here"] = _compared(experiment.as_thesis, results["as_thesis"])
    return columns | {"here": _compared(experiment, results)}


def _compared(experiment: Experiment, results: Mapping[str, Any]) -> dict[str, str]:
    effective = results["config"].get("effective", {})
    right = sum(bool(m["correct"]) for m in results["matches"]) if results["truth"] != "none" else None
    registration = results["registration"]
    return {
        "landmarks": " / ".join(
            f"{len(n.landmarks):,}" for n in (experiment.place_map.navigation, experiment.navigation)
        ),
        "places / locations": f"{results['places']} / {results['locations']}",
        "cluster lengths": ", ".join(
            f"{key.replace('_', ' ')} {_number(value)}"
            for key, value in effective.items()
            if value is not None and value is not False
        ),
        "inlier ratio": _number(registration["inlier_ratio"]),
        "registration RMSE": f"{_number(registration['rmse'])} {_rmse_unit(experiment)}",
        "registration RMSE, normalised": _number(registration["rmse_normalised"]),
        "true error of the registration": "–"
        if results["truth"] == "none"
        else f"{_number(registration['error_m'])} m",
        "matches": str(len(results["matches"])) + ("" if right is None else f", of them right by truth: {right}"),
    }


def _rmse_unit(experiment: Experiment) -> str:
    return "normalised" if registers_normalised(experiment) else unit_of(experiment.place_map.navigation)


def _uncertainty(experiment: Experiment) -> str:
    """One standard deviation of the motion, for a person."""
    known = uncertainty_of(experiment.result.registration)
    if known is None:
        return "–"
    unit = unit_of(experiment.place_map.navigation)
    return f"{math.degrees(known.rotation_rad):.2g}°, {known.position:.2g} {unit}, {known.scale:.2g} of scale"


def _number(value: Any, digits: int = 3) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    return f"{value:,}" if isinstance(value, int) else f"{value:.{digits}g}"


def _data_uri(path: Path) -> str:
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode()
