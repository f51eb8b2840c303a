"""`station calibrate wheels`: how far the wheels really carry and turn the robot."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated, Any

import typer

from shared.calibration import WheelCalibration
from shared.disk import replace_file
from shared.errors import DataError
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
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            help="The section pi to write where --full-speed and --track are given, else the section wheels of a"
            " calibration.yaml; nothing is written when refused.",
        ),
    ],
    full_speed: Annotated[
        float | None, typer.Option(min=0.01, max=10.0, help="pi.full_speed_m_s that the robot drove with, m/s.")
    ] = None,
    track: Annotated[
        float | None, typer.Option(min=0.01, max=10.0, help="pi.track_m that the robot drove with, m.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Measure the wheels: full speed, track width, slip, lag. Exit code 2 when the drive does not tell; says why."""
    if (full_speed is None) != (track is None):
        raise DataError("give both --full-speed and --track, which the robot drove with (its section pi), or neither")
    check_out_file(out)
    board = read_target(target)
    data = open_dataset(dataset)
    with working("looking for the board") as bar:
        bar.step("looking for the board", len(data.frame_times_ns))
        found = calibrate_wheels(data, board, bar.advance)
    answer = report(found, full_speed, track)
    if found.accepted:
        before = data.calibration.wheel_factors
        section = wheels_section(answer, before) if full_speed is None else _pi_section(answer)
        replace_file(out, section.encode())
    print(json.dumps(answer) if as_json else "\n".join(_sentences(answer, out)))
    if not found.accepted:
        raise typer.Exit(2)


def _pi_section(answer: dict[str, Any]) -> str:
    return f"[pi]\nfull_speed_m_s = {answer['full_speed_m_s']:.4f}\ntrack_m = {answer['track_m']:.4f}\n"


def wheels_section(answer: dict[str, Any], before: WheelCalibration) -> str:
    """What the robot's motors make of a command; `before`: as measured earlier, with which it drove."""
    factors = WheelCalibration(speed=before.speed * answer["speed_factor"], turn=before.turn * answer["turn_factor"])
    return f"wheels:\n  speed: {factors.speed:.4f}\n  turn: {factors.turn:.4f}\n"


def report(found: Wheels, full_speed_m_s: float | None, track_m: float | None) -> dict[str, Any]:
    """The JSON object; what was not measured, or cannot be told without what the robot drove with, is null.

    The robot turned a command of its speed and track into wheel speeds; those it should have used come out. `slip` is
    how much less it turned than its wheels rolled, by the track that it drove with.
    """
    speed, turn = found.speed, found.turn
    full = None if speed is None or full_speed_m_s is None else full_speed_m_s * speed.value
    turns_less = None if speed is None or turn is None or not turn.value else turn.value / speed.value
    wide = None if track_m is None or turns_less is None else track_m / turns_less
    sigma = {
        "full_speed_m_s": None if full is None or speed is None else full * _relative(speed),
        "track_m": None,
        "speed_factor": None if speed is None else speed.sigma,
        "turn_factor": None if turn is None else turn.sigma,
        "lag_s": found.lag_sigma_s,
    }
    if wide is not None and speed is not None and turn is not None:
        sigma["track_m"] = abs(wide) * math.hypot(_relative(speed), _relative(turn))
    return {
        "full_speed_m_s": full,
        "track_m": wide,
        "speed_factor": None if speed is None else speed.value,
        "turn_factor": None if turn is None else turn.value,
        "slip": None if turns_less is None else 1.0 - turns_less,
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
    if answer["track_m"] is None:
        figures = [
            f"{answer['speed_factor']:.4f} of a commanded speed is driven, sigma {sigma['speed_factor']:.4f}",
            f"{answer['turn_factor']:.4f} of a commanded turn is made, sigma {sigma['turn_factor']:.4f}",
        ]
        where = (
            "put it into the robot's calibration.yaml (for its section pi instead, give --full-speed and --track, which"
            " it drove with)"
        )
    else:
        figures = [
            f"full speed {answer['full_speed_m_s']:.4f} m/s, sigma {sigma['full_speed_m_s']:.4f}",
            f"track {answer['track_m']:.4f} m, sigma {sigma['track_m']:.4f}",
        ]
        where = "put it into the robot's configuration"
    return [
        *figures,
        f"it turns {_less(answer['slip'])} than its wheels roll, by the track that it drove with",
        *_lag(answer["lag_s"]),
        f"written to {out}: {where}",
    ]


def _less(share: float) -> str:
    return f"{100 * share:.0f} % less" if share >= 0 else f"{-100 * share:.0f} % more"


def _lag(lag_s: float | None) -> list[str]:
    if lag_s is None:
        return []
    return [f"the motors follow a command with lag_s {lag_s:.4f} s, twice in a row (motor and gear)"]
