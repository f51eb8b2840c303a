"""Where commands may write."""

from __future__ import annotations

from pathlib import Path

import pytest

from shared.errors import DataError
from station.commands.options import check_out_file


@pytest.mark.parametrize("out", ["/proc/camera.yaml", "/sys/camera.yaml", "/nowhere/camera.yaml", "/proc"])
def test_a_file_that_nobody_can_make_is_refused_before_the_work(out: str) -> None:
    with pytest.raises(DataError, match=f"--out {out}"):
        check_out_file(Path(out))


def test_nothing_is_made_by_asking(tmp_path: Path) -> None:
    check_out_file(tmp_path / "camera.yaml")
    assert list(tmp_path.iterdir()) == []
