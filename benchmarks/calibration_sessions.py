"""Simulated calibration sessions for benchmarks: rendered once, given to the command, and what it must say of mistakes.

A poor session must be refused, and one of the reasons must name the remedy of the mistake that was made.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from benchmarks.result import Figure, share
from robot.simulation.calibration.conduct import POOR
from robot.simulation.calibration.kind import Kind
from robot.simulation.calibration.sessions import record_session
from station.main import app

# What some reason against each poor session must say, as a regular expression; written from the mistake.
REMEDIES: Mapping[Kind, Mapping[str, str]] = MappingProxyType(
    {
        Kind.CAMERA: {
            "too-few": "take 20 to 40|take more images",
            "too-dark": "more light",
            "too-far": "nearer",
            "one-orientation": "tilt",
            "defocused": "focus",
            "shaken": "hold it still|held still|hold the board still",
            "bent-board": "flat",
            "middle-only": "hold it also .* of the image|all over the image|over the whole image",
        },
        Kind.CAMERA_IMU: {
            "too-short": "record (longer|30 to 60 s)",
            "too-still": "wave it faster",
            "too-dark": "more light",
            "too-far": "nearer",
            "one-axis": "tilt it up and down and turn it left and right",  # it was rolled
            "wrong-target-size": "measure one, correct the file",
            "defocused": "sharp lens|focus the lens",
            "no-imu": "record the IMU",
            "bent-board": "flat and stiff",
            "moved-board": "the target moved|keep the target where it is",
        },
        Kind.WHEELS: {
            "too-short": "record a minute|drive to and fro",
            "too-dark": "in good light",
            "too-far": "near enough",
            "no-imu": "with its IMU",
            "no-drives": "drive to and fro",
            "no-turns": "turn on the spot",
            "no-rests": "pause two seconds",
            "blocked": "free the robot's way",
        },
    }
)


def session(work: Path, kind: Kind, seed: int, poor: str | None = None) -> Path:
    """An ASL folder, rendered where it is missing."""
    folder = work / f"{kind}-{seed}{'-' + poor if poor else ''}"
    if not folder.exists():
        record_session(kind, folder, seed, poor)
    return folder


def truth_of(folder: Path) -> dict[str, Any]:
    """What the session was made with."""
    return dict(json.loads((folder / "truth.json").read_text()))


def calibrate(kind: Kind, folder: Path) -> dict[str, Any]:
    """What `station calibrate` prints, and the seconds that it took."""
    out = folder.with_suffix(".yaml")
    command = ["calibrate", kind.value, str(folder), "--target", str(folder / "target.yaml"), "--out", str(out)]
    printed = io.StringIO()
    wall, cpu = time.perf_counter(), time.process_time()
    with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
        app([*command, "--json"], standalone_mode=False)
    seconds = {"wall_s": round(time.perf_counter() - wall, 1), "cpu_s": round(time.process_time() - cpu, 1)}
    return json.loads(printed.getvalue().splitlines()[-1]) | seconds


def poor_row(kind: Kind, poor: str, found: dict[str, Any]) -> dict[str, Any]:
    """What came of one poor session: whether it was refused, and whether a reason names the remedy."""
    is_remedied = any(re.search(REMEDIES[kind][poor], reason) for reason in found["reasons"])
    return {"poor": poor, "accepted": found["accepted"], "remedied": is_remedied, "reasons": found["reasons"]}


def poor_sessions(work: Path, kind: Kind, first_seed: int) -> list[dict[str, Any]]:
    """A row for each mistake that the simulator knows, each printed."""
    rows = []
    for number, poor in enumerate(POOR[kind]):
        rows.append(poor_row(kind, poor, calibrate(kind, session(work, kind, first_seed + number, poor))))
        print(json.dumps(rows[-1]), flush=True)
    return rows


def refusals(kind: Kind, rows: Sequence[dict[str, Any]]) -> list[Figure]:
    """Of poor sessions: how many were accepted, how many were told the right remedy."""
    accepted = [row["poor"] for row in rows if row["accepted"]]
    remedied = [row for row in rows if row["remedied"] and not row["accepted"]]
    others = "; ".join(f"{row['poor']}: {' '.join(row['reasons'])}" for row in rows if row not in remedied)
    return [
        share(f"{kind}: poor recordings accepted", len(accepted), len(rows), at_most=0.0, note=", ".join(accepted)),
        share(
            f"{kind}: poor recordings refused with the right remedy", len(remedied), len(rows), at_least=100.0,
            note=others,
        ),
    ]  # fmt: skip
