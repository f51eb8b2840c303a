"""`station register`: how one point cloud lies in another's frame."""

from __future__ import annotations

import json
import math
import sys
import time
from pathlib import Path
from typing import Annotated, Literal

import typer

from station.commands.progress import working


def register(app: typer.Typer) -> None:
    app.command("register")(register_files)


def register_files(
    target: Annotated[Path, typer.Argument(help="PLY cloud whose frame is wanted.")],
    source: Annotated[Path, typer.Argument(help="PLY cloud to be placed in it.")],
    scale: Annotated[Literal["known", "free"], typer.Option(help="known: both clouds in one unit.")] = "known",
    gravity: Annotated[Literal["known", "unknown"], typer.Option(help="known: z is up in both clouds.")] = "known",
    backend: Annotated[Literal["small_gicp", "open3d"], typer.Option(help="Library of the GICP step.")] = "small_gicp",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random subsets.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="End with one JSON object on stdout.")] = False,
) -> None:
    """Register SOURCE to TARGET without a guess; exit code 0 only when the result is accepted."""
    from station.files.ply import read_rows
    from station.places.registration.register import register_clouds
    from station.places.registration.result import finite, registration_json, uncertainty_of

    p_target, p_source = read_rows(target), read_rows(source)  # registration says what is wrong with them
    print(f"registering {len(p_source)} points of {source} to {len(p_target)} of {target} ...", file=sys.stderr)
    start = time.perf_counter()
    with working("registering"):
        result = register_clouds(p_target, p_source, scale=scale, gravity=gravity, backend=backend, seed=seed)
    seconds = time.perf_counter() - start
    uncertainty = uncertainty_of(result)
    if not as_json:
        print(result)
        if result.T_target_source is not None:
            for row in result.T_target_source.tolist():
                print("  " + " ".join(f"{value: .6f}" for value in row))
            print(f"scale {result.scale:.4f}, overlap {result.overlap:.0%}, rmse {result.rmse:.4f}, {seconds:.2f} s")
            if uncertainty is not None:
                turn = math.degrees(uncertainty.rotation_rad)
                loose = f", {uncertainty.scale:.2%} of scale" if scale == "free" else ""
                print(f"one standard deviation: {turn:.3f} degrees, {uncertainty.position:.4f}{loose}")
    else:
        print(result, file=sys.stderr)
        print(
            json.dumps(
                {
                    **registration_json(result),
                    "seconds": seconds,
                    "score": result.score,
                    "confidence": finite(result.confidence),
                    "evidence": result.measured,
                    "eigenvalues": None if result.eigenvalues is None else result.eigenvalues.tolist(),
                    "alternatives": [
                        {"T_target_source": a.T_target_source.tolist(), "score": a.score} for a in result.alternatives
                    ],
                }
            )
        )
    if not result.accepted:
        raise typer.Exit(2)
