"""What an experiment leaves behind: results.json, report.html and figures, whole or not at all."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from pathlib import Path

from shared.errors import DataError
from station.experiments.experiment import Experiment, results_dict
from station.experiments.figures import draw_figures
from station.experiments.report import write_report


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
