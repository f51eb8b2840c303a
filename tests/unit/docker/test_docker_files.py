"""What the images promise can be kept by the user they run as."""

from __future__ import annotations

import re

import pytest
import yaml

from tests.support.paths import ROOT

DOCKER = ROOT / "docker"
FILES = ["station.Dockerfile", "robot.Dockerfile"]


@pytest.mark.parametrize("name", FILES)
def test_a_volumes_folder_belongs_to_the_user_who_writes_there(name: str) -> None:
    before, user, _ = (DOCKER / name).read_text().partition("\nUSER ")
    assert user, "nothing may run as root"
    for volume in re.findall(r"^VOLUME (\S+)$", (DOCKER / name).read_text(), re.MULTILINE):
        assert f"mkdir {volume} && chown sentinel:sentinel {volume}" in before


def test_composed_volumes_are_the_images_own() -> None:
    for path in re.findall(r"station-data:(/\S+?)\"", (DOCKER / "compose.yaml").read_text()):
        assert f"VOLUME {path}\n" in (DOCKER / "station.Dockerfile").read_text()


def test_composed_programs_may_listen_where_they_do() -> None:
    services = yaml.safe_load((DOCKER / "compose.yaml").read_text())["services"]
    for service in services.values():
        assert "--insecure" in service["command"] or "0.0.0.0" not in service["command"]
        assert all(port.startswith("127.0.0.1:") for port in service.get("ports", ()))


def test_what_the_images_copy_is_sent_to_docker_and_nothing_else() -> None:
    copied: set[str] = set()
    for name in FILES:
        for line in re.findall(r"^COPY (.+)$", (DOCKER / name).read_text(), re.MULTILINE):
            copied.update(line.split()[:-1])
    rules = [line for line in (ROOT / ".dockerignore").read_text().splitlines() if not line.startswith("#")]
    assert rules[0] == "*"
    kept = {rule.removeprefix("!") for rule in rules if rule.startswith("!")}
    assert kept == copied
    made_here = {line.strip("/") for line in (ROOT / ".gitignore").read_text().splitlines()}
    left_out = {rule.removeprefix("**/") for rule in rules[1:] if not rule.startswith("!")}
    assert left_out <= made_here, "a file of the repository is left out"
