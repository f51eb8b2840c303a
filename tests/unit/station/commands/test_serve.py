"""What `station serve` makes of its file and its options."""

from __future__ import annotations

from pathlib import Path

import pytest

from shared.errors import ConfigError
from station.commands.serve import _settings as serve_settings
from station.config import (
    ApiConfig,
    SlamConfig,
    StationConfig,
)


def test_options_of_serve_keep_what_the_file_says_beside_them() -> None:
    config = StationConfig(api=ApiConfig(host="0.0.0.0", allowed_hosts=("robots.local",)))
    settings = serve_settings(config, ["pi:7"], None, 9000, None, "ukf", False)
    assert settings.api == ApiConfig("0.0.0.0", 9000, ("robots.local",))
    assert (settings.slam.backend, settings.fleet[0].host) == ("ukf", "pi")


@pytest.mark.parametrize(
    "name", ["nonsense", "", "tests.support.made_up_workers:Nothing", "no_such_module:Slam", ":Slam"]
)
def test_a_backend_that_does_not_exist_is_named_before_anything_starts(name: str) -> None:
    with pytest.raises(ConfigError, match="choose one of auto, sfm, ukf, mono"):
        serve_settings(StationConfig(slam=SlamConfig(backend=name)), None, None, None, None, None, False)


def test_a_data_folder_that_is_a_file_is_named_before_anything_starts(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="--data"):
        serve_settings(StationConfig(), None, None, None, tmp_path / "file", None, False)
    with pytest.raises(ConfigError, match="data_dir"):
        serve_settings(StationConfig(tmp_path / "file"), None, None, None, None, None, False)
