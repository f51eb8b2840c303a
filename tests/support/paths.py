"""Where things lie."""

from pathlib import Path

ROOT = Path(__file__).parents[2]  # of the project
RECORDINGS = ROOT.parent / "shared" / "data"  # real recordings, where this machine has them
