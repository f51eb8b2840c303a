"""`station calibrate wheels`: how far the wheels really carry and turn the robot."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from shared.disk import replace_file
from station.calibration.target_file import read_target
from station.calibration.wheels import Factor, Wheels, calibrate_wheels
from station.commands.options import Json, check_out_file
from station.commands.progress import working
from station.datasets import open_dataset


def register(app: typer.Typer) -> None:
    app.command()(wheels)


def wheels(
    dataset: Annotated[Path, typer.Argument(help="A drive to and fro before the board, with turns and pauses.")],
    target: Annotated[Path, typer.Option("--target", help="The target.yaml of the board.")],
    out: Annotated[Path, typer.Option("--out", help="The [pi] section to write; nothing is written when refused.")],
    full_speed: Annotated[
        float, typer.Option(min=0.01, max=10.0, help="pi.full_speed_m_s that the robot drove with, m/s.")
    ] = 0.6,
    track: Annotated[float, typer.Option(min=0.01, max=10.0, help="pi.track_m that the robot drove with, m.")] = 0.25,
    as_json: Json = False,
) -> None:
    """Measure the wheels: full speed, track width, slip, lag. Exit code 2 when the drive does not tell; says why."""
    check_out_file(out)
    board = read_target(target)
    data = open_dataset(dataset)
    with working("looking for the board") as bar:
        bar.step("looking for the board", len(data.frame_times_ns))
        found = calibrate_wheels(data, board, bar.advance)
    answer = report(found, full_speed, track)
    if found.accepted:
        section = f"[pi]\nfull_speed_m_s = {answer['full_speed_m_s']:.4f}\ntrack_m = {answer['track_m']:.4f}\n"
        replace_file(out, section.encode())
    print(json.dumps(answer) if as_json else "\n".join(_sentences(answer, out)))
    if not found.accepted:
        raise typer.Exit(2)


def report(found: Wheels, full_speed_m_s: float, track_m: float) -> dict[str, Any]:
    """The JSON object; what was not measured is null.

    The robot turned a command of its speed and track into wheel speeds; those it should have used come out.
    """
    speed, turn = found.speed, found.turn
    sigma: dict[str, float | None] = {
        "full_speed_m_s": None if speed is None else speed.sigma * full_speed_m_s,
        "track_m": None,
        "lag_s": found.lag_sigma_s,
    }
    wide = None
    if speed is not None and turn is not None and turn.value:
        wide = track_m * speed.value / turn.value
        sigma["track_m"] = abs(wide) * (_relative(speed) ** 2 + _relative(turn) ** 2) ** 0.5
    return {
        "full_speed_m_s": None if speed is None else full_speed_m_s * speed.value,
        "track_m": wide,
        "speed_factor": None if speed is None else speed.value,
        "turn_factor": None if turn is None else turn.value,
        "slip": None if wide is None else 1.0 - track_m / wide,
        "lag_s": found.lag_s,
        "sigma": sigma,
        "drives": 0 if speed is None else speed.moves,
        "turns": 0 if turn is None else turn.moves,
        "speeds": _speeds(found),
        "accepted": found.accepted,
        "reasons": list(found.reasons),
    }


def _relative(factor: Factor) -> float:
    return factor.sigma / abs(factor.value)


def _speeds(found: Wheels) -> list[dict[str, float]]:
    """Each straight drive: what was commanded, and how much of it was achieved."""
    return [
        {"command_m_s": m.command_m_s, "factor": m.went_m / m.linear_m}
        for m in found.moves
        if m.went_m is not None and m.is_drive
    ]


def _sentences(answer: dict[str, Any], out: Path) -> list[str]:
    if not answer["accepted"]:
        return ["refused:", *(f"  {reason}" for reason in answer["reasons"])]
    sigma = answer["sigma"]
    return [
        f"full speed {answer['full_speed_m_s']:.4f} m/s, sigma {sigma['full_speed_m_s']:.4f}",
        f"track {answer['track_m']:.4f} m, sigma {sigma['track_m']:.4f}",
        f"slip in turns {100 * answer['slip']:.0f} %",
        *([] if answer["lag_s"] is None else [f"the motors answer {2 * answer['lag_s']:.2f} s late"]),
        f"written to {out}: put it into the robot's configuration",
    ]
