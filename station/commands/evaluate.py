"""`station evaluate`: a navigation compared with the true poses of its dataset."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from shared.errors import DataError, DegenerateGeometry
from station.commands.navigations import NavigationArgument, navigation_folder, open_navigation
from station.commands.options import Config, Data, check_out_folder
from station.commands.progress import working
from station.commands.results_folder import check_results_folder, write_results
from station.datasets import Dataset, open_dataset
from station.experiments.evaluation import DRIFT_OVER_S, Evaluation, evaluate
from station.experiments.evaluation_figures import ERRORS, PATH, draw_evaluation

RESULTS = "evaluation.json"
NO_TRUTH = 2  # exit code


def register(app: typer.Typer) -> None:
    app.command("evaluate")(evaluate_command)


def evaluate_command(
    navigation: NavigationArgument,
    dataset: Annotated[Path, typer.Argument(help="The dataset it was made from, with true poses.")],
    align: Annotated[
        Literal["yaw", "se3", "sim3"] | None,
        typer.Option(
            help="What may be fitted before positions are compared: yaw and position, rotation and position, or scale"
            " too. By default what the navigation leaves open: yaw where it knows gravity and metres, se3 where only"
            " metres, else sim3.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Folder for evaluation.json, errors.png and path.png; by default NAVIGATION-evaluation, beside the"
            " navigation.",
        ),
    ] = None,
    first: Annotated[int | None, typer.Option(help="Number of the dataset's first frame, as of station slam.")] = None,
    last: Annotated[int | None, typer.Option(help="Number of its last frame.")] = None,
    data: Data = None,
    config: Config = None,
    as_json: Annotated[bool, typer.Option("--json", help="End with one JSON object on stdout.")] = False,
) -> None:
    """Compare a navigation with true poses: ATE, RPE over 1 s, orientation, scale, coverage, and figures over time.

    As evo defines them: ATE is the RMSE of the positions' distances after alignment, rot_rmse_deg that of the angles,
    RPE that of the translations over 1 s, of all pairs of poses that far apart (null where there is none). Truth is
    interpolated at the navigation's times. scale is the truth's lengths over the navigation's, fitted whatever the
    alignment. coverage is the share of the dataset's frames with a true pose that have an estimated one.
    """
    folder = out or default_folder(navigation)
    check_out_folder(folder)
    check_results_folder(folder, {RESULTS, ERRORS, PATH})
    with working("reading the navigation") as bar:
        estimate = open_navigation(navigation, data, config)
        bar.step("reading the true poses")
        recorded = open_dataset(dataset, first, last)
        _check_truth(recorded)
        bar.step("comparing")
        try:
            found = evaluate(estimate, recorded, align)
        except DegenerateGeometry as exc:
            raise DataError(
                f"{navigation} cannot be compared with {dataset}: {exc}; give what it was made from"
            ) from exc
        bar.step("drawing")
        results = found.results()
        with write_results(folder) as fresh:
            (fresh / RESULTS).write_text(json.dumps(results, indent=1) + "\n")
            draw_evaluation(found, Path(navigation).name, fresh)
    print(json.dumps(results) if as_json else summary(found, folder))


def default_folder(navigation: str) -> Path:
    """Beside the navigation's folder, whose own content is fixed."""
    given = Path(navigation)
    found = navigation_folder(given) or given
    if not found.name.strip("."):  # `.` and `..` have no name
        found = found.resolve()
    return found.with_name(f"{found.name}-evaluation")


def _check_truth(data: Dataset) -> None:
    if data.truth is None:
        print(f"station: {data.path} holds no true poses; name a dataset that has them", file=sys.stderr)
        raise typer.Exit(NO_TRUTH)


def summary(found: Evaluation, folder: Path) -> str:
    """What a person wants to know."""
    results = found.results()
    drift = "no two poses lie that far apart" if found.relative is None else f"{results['rpe_1s_rmse']:.4f} m"
    scale = "unknown: all lie on one line" if found.scale is None else f"{found.scale:.4f}"
    return "\n".join(
        [
            f"ATE          {results['ate_rmse']:.4f} m (RMSE of {results['poses']} poses, aligned by {found.kind})",
            f"RPE, {DRIFT_OVER_S:.0f} s     {drift}",
            f"orientation  {results['rot_rmse_deg']:.3f}° (RMSE)",
            f"scale        {scale}",
            f"coverage     {found.coverage:.1%} of the frames",
            f"written to {folder}",
        ]
    )
