"""One TOML file, checked at once."""

from __future__ import annotations

from pathlib import Path

import pytest

from robot.app import named
from robot.config import IdentityConfig, RobotConfig, load_config
from shared.errors import ConfigError


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "robot.toml"
    path.write_text(text)
    return path


def test_defaults_work_without_a_file() -> None:
    assert load_config(None, {}) == RobotConfig()
    assert (RobotConfig().server.host, RobotConfig().server.port) == ("127.0.0.1", 7400)


def test_a_simulated_robot_that_nobody_named_is_called_that_and_another_keeps_its_name() -> None:
    assert named("simulated", RobotConfig()).identity.name == "Simulated robot"
    assert named("pi", RobotConfig()) == RobotConfig()
    mine = RobotConfig(identity=IdentityConfig(name="Rosa"))
    assert named("simulated", mine) == mine


def test_command_line_overrides_the_file(tmp_path: Path) -> None:
    path = written(tmp_path, '[server]\nport = 7500\nhost = "0.0.0.0"\n')
    config = load_config(path, {"server": {"port": 7600, "host": None}})
    assert (config.server.port, config.server.host) == (7600, "0.0.0.0")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[server]\nprot = 1\n", "unknown field `prot`.*server"),
        ("[wheels]\nx = 1\n", "unknown field `wheels`"),
        ('[server]\nport = "a"\n', "Expected `int`.*server.port"),
        ("[server]\nport = 70000\n", "<= 65535.*server.port"),
        ("[drive]\nmax_linear_m_s = 99.0\n", "<= 3.*drive.max_linear_m_s"),
        ("[drive\n", "not valid TOML"),
        ('[identity]\nname = "Rosa\\u200b"\n', "characters that can be seen.*identity.name"),
        ('[identity]\nname = "  "\n', "needs a character that is seen.*identity"),
    ],
)
def test_a_mistake_in_the_file_is_one_sentence_with_file_and_key(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said) as caught:
        load_config(written(tmp_path, text), {})
    assert "robot.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.toml cannot be read"):
        load_config(tmp_path / "none.toml", {})


def test_a_wrong_option_is_the_command_lines(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"the command line: .*port"):
        load_config(written(tmp_path, ""), {"server": {"port": -1}})
    with pytest.raises(ConfigError, match=r"the command line: .*seed"):
        load_config(None, {"simulated": {"seed": -1}})
