"""Where commands may write."""

from __future__ import annotations

from pathlib import Path

import pytest

from shared.errors import ConfigError, DataError
from station.commands.options import check_out_file, data_folder
from station.config import StationConfig


@pytest.mark.parametrize("out", ["/proc/camera.yaml", "/sys/camera.yaml", "/nowhere/camera.yaml", "/proc"])
def test_a_file_that_nobody_can_make_is_refused_before_the_work(out: str) -> None:
    with pytest.raises(DataError, match=f"--out {out}"):
        check_out_file(Path(out))


def test_nothing_is_made_by_asking(tmp_path: Path) -> None:
    check_out_file(tmp_path / "camera.yaml")
    assert list(tmp_path.iterdir()) == []


def test_the_data_folder_is_the_option_and_else_the_settings(tmp_path: Path) -> None:
    settings = StationConfig(tmp_path / "settings")
    assert data_folder(tmp_path / "option", settings) == tmp_path / "option"
    assert data_folder(None, settings) == tmp_path / "settings"


def test_a_data_folder_that_is_a_file_is_refused_by_the_name_of_its_setting(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=r"^--data = .*file"):
        data_folder(tmp_path / "file", StationConfig())
    with pytest.raises(ConfigError, match=r"^data_dir = .*file"):
        data_folder(None, StationConfig(tmp_path / "file"))
