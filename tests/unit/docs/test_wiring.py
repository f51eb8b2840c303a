"""One wiring: the drawing, the table in docs/robot.md and the firmware's pins agree."""

import re
import subprocess
import sys

from tests.support.paths import ROOT


def test_drawing_and_table_are_up_to_date() -> None:
    run = subprocess.run(
        [sys.executable, "scripts/draw_wiring.py", "--check"], cwd=ROOT, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stdout


def test_the_firmware_uses_the_pins_of_the_table() -> None:
    board = (ROOT / "firmware" / "sentinel" / "board.h").read_text()
    pins = {p for row in re.findall(r"^// \|[^|]*\|([^|]*)\|", board, re.M) for p in re.findall(r"A?\d+", row)}
    page = (ROOT / "docs" / "robot.md").read_text()
    wired = set(re.findall(r"^\| (A?\d+)\b", page, re.M))
    assert wired and wired <= pins
