"""Writes and prints what came of matching two navigations."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import typer

from station.commands.progress import working
from station.commands.results_folder import naming_replaced
from station.experiments.experiment import Experiment, results_dict
from station.experiments.report import write_experiment


def finish(done: Experiment, out: Path, as_json: bool) -> None:
    """Write the files and say what came out. Exit code 2 when registration was refused, as of `station register`."""
    with naming_replaced(out, "the report", "results.json"), working("drawing the report"):
        write_experiment(done, out)
    results = results_dict(done)
    if as_json:
        print(json.dumps(results, default=str))
    else:
        _tell(done, results, out)
    if not done.result.registration.accepted:
        why = done.result.registration.reasons[0]
        print(f"station: nothing was matched, since registration is refused: {why}", file=sys.stderr)
        raise typer.Exit(2)


def _tell(done: Experiment, results: dict[str, Any], out: Path) -> None:
    print(f"{results['places']} places, {results['locations']} locations, {len(results['matches'])} matches")
    if not results["places"]:
        print("the map holds no place, so there was nothing to match with")
    if not done.result.registration.accepted:
        print(f"registration {done.result.registration}")
    if done.not_judged:
        print(done.not_judged)
    if results["precision"] is not None:
        print(f"precision {results['precision']:.3f} by the recorded poses")
    if results["recall"] is not None:
        print(f"recall {results['recall']:.3f} of {len(results['co_visible'])} co-visible places")
    print(f"written to {out / 'report.html'}")
