"""What the images promise can be kept by the user they run as."""

import re

import pytest

from tests.support.paths import ROOT

DOCKER = ROOT / "docker"


@pytest.mark.parametrize("name", ["station.Dockerfile", "robot.Dockerfile"])
def test_a_volumes_folder_belongs_to_the_user_who_writes_there(name: str) -> None:
    before, user, _ = (DOCKER / name).read_text().partition("\nUSER ")
    assert user, "nothing may run as root"
    for volume in re.findall(r"^VOLUME (\S+)$", (DOCKER / name).read_text(), re.MULTILINE):
        assert f"mkdir {volume} && chown sentinel:sentinel {volume}" in before


def test_composed_volumes_are_the_images_own() -> None:
    for path in re.findall(r"station-data:(/\S+?)\"", (DOCKER / "compose.yaml").read_text()):
        assert f"VOLUME {path}\n" in (DOCKER / "station.Dockerfile").read_text()
