"""Where the robot's key and tokens are, as the settings say it."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from robot.access import open_gate
from robot.access_commands import cli
from robot.config import AccessConfig, RobotConfig, ServerConfig
from shared.errors import ConfigError


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A file where the settings should name a folder."""
    path = tmp_path / "key.pem"
    path.write_text("of somebody")
    return path


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_a_folder_that_is_a_file_is_refused_by_the_name_of_its_setting(file: Path, host: str) -> None:
    config = RobotConfig(server=ServerConfig(host=host), access=AccessConfig(folder=str(file)))
    with pytest.raises(ConfigError, match=r"access\.folder .*key\.pem is no folder") as refused:
        open_gate(config)
    assert "Not a directory" not in str(refused.value)


@pytest.mark.parametrize("words", [("access", "init"), ("access", "list"), ("access", "revoke", "x"), ("pair",)])
def test_commands_refuse_it_the_same_way(file: Path, tmp_path: Path, words: tuple[str, ...]) -> None:
    config = tmp_path / "robot.toml"
    config.write_text(f'[access]\nfolder = "{file}"\n')
    for options, name in ((["--config", str(config)], "access.folder"), (["--folder", str(file)], "--folder")):
        refused = CliRunner().invoke(cli, [*words, *options]).exception
        assert isinstance(refused, ConfigError) and f"{name} " in str(refused) and "is no folder" in str(refused)
    assert file.read_text() == "of somebody"
