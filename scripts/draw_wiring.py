"""Draws docs/figures/wiring.svg and the wiring table of docs/robot.md from one list, so that they cannot disagree.

python scripts/draw_wiring.py [--check]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from html import escape
from pathlib import Path

ROOT = Path(__file__).parents[1]
SVG = ROOT / "docs" / "figures" / "wiring.svg"
PAGE = ROOT / "docs" / "robot.md"
BEGIN, END = "<!-- wiring table: scripts/draw_wiring.py -->", "<!-- end of wiring table -->"


@dataclass(frozen=True)
class Wire:
    """From a Mega pin to a pin of a part."""

    mega: str
    part: str
    pin: str
    note: str
    colour: str


POWER, GROUND, BUS, MOTOR, SERVO, SENSE = "#c0392b", "#2c3e50", "#2471a3", "#d68910", "#7d3c98", "#1e8449"
WIRES = [
    Wire("3.3V", "ICM-20948", "VIN (3.3 V)", "not 5 V: the chip's lines are 3.3 V", POWER),
    Wire("GND", "ICM-20948", "GND", "", GROUND),
    Wire("20 (SDA)", "ICM-20948", "SDA", "level shifter 5 V to 3.3 V, or the breakout's own", BUS),
    Wire("21 (SCL)", "ICM-20948", "SCL", "as SDA", BUS),
    Wire("2 (INT4)", "ICM-20948", "INT", "data ready, 225 times a second", BUS),
    Wire("6 (OC4A)", "DRV8833", "AIN1", "left motors", MOTOR),
    Wire("7 (OC4B)", "DRV8833", "AIN2", "", MOTOR),
    Wire("5 (OC3A)", "DRV8833", "BIN1", "right motors", MOTOR),
    Wire("3 (OC3C)", "DRV8833", "BIN2", "", MOTOR),
    Wire("4", "DRV8833", "SLP", "low: driver off, also while the Mega resets (10 kOhm to GND)", MOTOR),
    Wire("8", "DRV8833", "FLT", "low: overcurrent or too hot", MOTOR),
    Wire("GND", "DRV8833", "GND", "one ground for everything", GROUND),
    Wire("11 (OC1A)", "Pan-tilt", "pan signal", "servo power from the 5 V power bank, not from the Mega", SERVO),
    Wire("12 (OC1B)", "Pan-tilt", "tilt signal", "", SERVO),
    Wire("GND", "Pan-tilt", "GND", "", GROUND),
    Wire("A0", "Battery divider", "middle", "100 kOhm to battery +, 33 kOhm to GND", SENSE),
    Wire("5V", "HC-SR04 (optional)", "VCC (5 V)", "hears how far the next thing ahead is", POWER),
    Wire("49", "HC-SR04 (optional)", "TRIG", "", SENSE),
    Wire("48 (ICP5)", "HC-SR04 (optional)", "ECHO", "5 V, as the Mega's pins take it", SENSE),
    Wire("GND", "HC-SR04 (optional)", "GND", "", GROUND),
    Wire("USB-B", "Raspberry Pi 4B", "USB-A", "500 kBd and the Mega's power", POWER),
]


def table() -> str:
    """Markdown."""
    lines = ["| Mega pin | part | its pin | note |", "| --- | --- | --- | --- |"]
    lines += [f"| {w.mega} | {w.part} | {w.pin} | {w.note} |" for w in WIRES]
    return "\n".join(lines)


def drawing() -> str:
    """SVG: the Mega on the left, parts on the right, one line per wire."""
    row, top, mega_x, part_x = 26, 60, 190, 560
    height = top + row * (len(WIRES) + len({w.part for w in WIRES})) + 40
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 860 {height}" font-family="sans-serif" font-size="13">',
        f'<rect width="860" height="{height}" fill="white"/>',
        '<text x="40" y="30" font-size="17" font-weight="bold">Wiring of the Sentinel robot</text>',
        f'<rect x="40" y="{top - 20}" width="150" height="{height - top}" rx="8" fill="#e8f1f8" stroke="#2471a3"/>',
        f'<text x="115" y="{top}" text-anchor="middle" font-weight="bold">Arduino Mega</text>',
    ]
    y, part_start, last_part = top + 12, 0, ""
    boxes: list[tuple[str, int, int]] = []
    for wire in WIRES:
        if wire.part != last_part:
            if last_part:
                boxes.append((last_part, part_start, y))
            y += row if last_part else 0
            part_start, last_part = y, wire.part
        y += row
        out.append(f'<text x="{mega_x - 8}" y="{y - 8}" text-anchor="end">{escape(wire.mega)}</text>')
        out.append(
            f'<line x1="{mega_x}" y1="{y - 12}" x2="{part_x}" y2="{y - 12}" stroke="{wire.colour}" stroke-width="2.5"/>'
        )
        out.append(f'<text x="{part_x + 8}" y="{y - 8}">{escape(wire.pin)}</text>')
    boxes.append((last_part, part_start, y))
    for part, start, end in boxes:
        out.append(
            f'<rect x="{part_x}" y="{start}" width="260" height="{end - start + 4}" rx="8" fill="none" stroke="#555"/>'
        )
        out.append(
            f'<text x="{part_x + 250}" y="{start + 18}" text-anchor="end" font-weight="bold">{escape(part)}</text>'
        )
    out.append("</svg>")
    return "\n".join(out) + "\n"


def page_with_table(page: str) -> str:
    """The page with the present table between its marks."""
    before, rest = page.split(BEGIN)
    _, after = rest.split(END)
    return f"{before}{BEGIN}\n{table()}\n{END}{after}"


def main() -> int:
    page, svg = PAGE.read_text(), drawing()
    wanted = page_with_table(page)
    if "--check" in sys.argv:
        good = wanted == page and SVG.exists() and SVG.read_text() == svg
        print("wiring is up to date" if good else "run python scripts/draw_wiring.py")
        return 0 if good else 1
    SVG.parent.mkdir(parents=True, exist_ok=True)
    SVG.write_text(svg)
    PAGE.write_text(wanted)
    return 0


if __name__ == "__main__":
    sys.exit(main())
