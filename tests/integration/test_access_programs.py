"""The programs: what refuses to start, who is let in from the command line, robot and PC paired as a person does it."""

from __future__ import annotations

import asyncio
import json
import signal
import ssl
from pathlib import Path

import httpx
import pytest
from typer.testing import CliRunner

import robot.access_commands
from shared.ending import ending_signals
from shared.errors import ConfigError
from shared.token_book import TokenBook
from station.main import app as station_app
from tests.support.programs import program, said


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        (("robot.main", "--devices", "simulated", "--config", "CONFIG"), "robot-server access init --folder"),
        (("station.main", "serve", "--data", "DATA", "--host", "0.0.0.0"), "station access init --data"),
    ],
)
async def test_beyond_loopback_nothing_starts_before_it_is_set_up_who_may(
    tmp_path: Path, words: tuple[str, ...], remedy: str
) -> None:
    config = tmp_path / "robot.toml"
    config.write_text(f'[server]\nhost = "0.0.0.0"\n[access]\nfolder = "{tmp_path / "none"}"\n')
    filled = [word.replace("CONFIG", str(config)).replace("DATA", str(tmp_path)) for word in words]
    async with program(*filled, "--port", "0") as process:
        out, err = await asyncio.wait_for(process.communicate(), 120)
        assert process.returncode == 1 and not out
        text = err.decode()
        assert text.count("\n") == 1 and remedy in text and "--host 0.0.0.0 lets others in" in text


async def test_a_person_pairs_a_robot_and_lets_somebody_in(tmp_path: Path) -> None:
    data, robot_toml, station_toml = tmp_path / "data", tmp_path / "robot.toml", tmp_path / "station.toml"
    robot_toml.write_text(f'[server]\nport = 0\n[access]\nfolder = "{tmp_path / "robot"}"\n')
    station_toml.write_text("[access]\non_loopback = true\n")
    run = CliRunner()
    assert run.invoke(robot.access_commands.cli, ["access", "init", "--config", str(robot_toml)]).exit_code == 0
    made = run.invoke(station_app, ["access", "init", "--data", str(data), "--json"])
    secrets = json.loads(made.stdout)
    async with program(
        "robot.main", "--devices", "simulated", "--world", "small", "--config", str(robot_toml)
    ) as robot_:
        port = (await said(robot_, r"devices on .*:(\d+)"))[1]
        code = (await said(robot_, r"pairing code (\d{3}-\d{3})"))[1]  # nobody is paired: it shows one by itself
        words = ("pair", f"127.0.0.1:{port}", "--code", code, "--data", str(data))
        async with program("station.main", *words) as pairing:
            out, err = await asyncio.wait_for(pairing.communicate(), 120)
            assert pairing.returncode == 0, err.decode()
            assert b"paired with" in out and f" --data {data}".encode() in out
            assert secrets["token"].encode() not in out + err
        serve = ("serve", "--robot", f"127.0.0.1:{port}", "--port", "0", "--data", str(data))
        async with program("station.main", *serve, "--config", str(station_toml)) as station_:
            address = (await said(station_, r"(https://\S+)"))[1]
            context = ssl.create_default_context(cafile=secrets["certificate"])
            async with httpx.AsyncClient(base_url=address, verify=context, timeout=30) as http:
                assert (await http.get("/robot")).status_code == 401
                token = {"Authorization": f"Bearer {secrets['token']}"}
                async with asyncio.timeout(60):
                    while not (await http.get("/robot", headers=token)).json()["connected"]:
                        await asyncio.sleep(0.1)
        listed = run.invoke(robot.access_commands.cli, ["access", "list", "--config", str(robot_toml), "--json"])
        assert [token["role"] for token in json.loads(listed.stdout)] == ["drive"]


def test_a_code_is_shown_with_the_port_that_the_robot_is_configured_for(tmp_path: Path) -> None:
    config = tmp_path / "robot.toml"
    config.write_text(f'[server]\nport = 7456\n[access]\nfolder = "{tmp_path / "robot"}"\n')
    run, options = CliRunner(), ["--config", str(config)]
    assert run.invoke(robot.access_commands.cli, ["access", "init", *options]).exit_code == 0
    assert ".local:7456 --code " in run.invoke(robot.access_commands.cli, ["pair", *options]).stdout
    by_folder = ["pair", "--folder", str(tmp_path / "robot")]
    assert ".local --code " in run.invoke(robot.access_commands.cli, by_folder).stdout


def test_tokens_are_added_listed_linked_and_revoked_from_the_command_line(tmp_path: Path) -> None:
    run, data = CliRunner(), ["--data", str(tmp_path)]
    first = json.loads(run.invoke(station_app, ["access", "init", *data, "--json"]).stdout)
    again = json.loads(run.invoke(station_app, ["access", "init", *data, "--json"]).stdout)
    assert first["token"] and again["token"] is None and first["fingerprint"] == again["fingerprint"]
    renewed = json.loads(run.invoke(station_app, ["access", "init", *data, "--renew", "--json"]).stdout)
    assert renewed["fingerprint"] != first["fingerprint"]
    anna = json.loads(run.invoke(station_app, ["access", "add", "anna", "--role", "drive", *data, "--json"]).stdout)
    book = TokenBook(tmp_path / "access")
    found = book.find(anna["token"], 0.0)
    assert found is not None and found.role.value == "drive"
    twice = run.invoke(station_app, ["access", "add", "anna", "--role", "drive", *data])
    assert isinstance(twice.exception, ConfigError)
    shown = run.invoke(station_app, ["access", "list", *data]).stdout
    assert "anna" in shown and anna["token"] not in shown
    link = run.invoke(station_app, ["access", "link", "anna", "--address", "https://here:1/", *data]).stdout.strip()
    assert link.startswith("https://here:1/#login=sentinel_")
    assert run.invoke(station_app, ["access", "revoke", "anna", *data]).exit_code == 0
    assert book.refresh() and book.find(anna["token"], 0.0) is None
    assert isinstance(run.invoke(station_app, ["access", "revoke", "anna", *data]).exception, ConfigError)
    for command in (["access", "list"], ["access", "add", "x", "--role", "watch"]):
        assert isinstance(run.invoke(station_app, [*command, "--data", "/nowhere"]).exception, ConfigError)


@pytest.mark.usefixtures("started_by_a_shell")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
async def test_a_signal_ends_the_station_in_good_order(tmp_path: Path, number: signal.Signals) -> None:
    words = ("serve", "--robot", "127.0.0.1:1", "--port", "0", "--data", str(tmp_path))
    async with program("station.main", *words) as process:
        await said(process, r"page and API at")
        process.send_signal(number)
        assert await asyncio.wait_for(process.wait(), 120) == 0


@pytest.mark.usefixtures("started_by_a_shell")
def test_what_was_started_to_outlive_its_terminal_does() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert signal.SIGHUP not in ending_signals()
    finally:
        signal.signal(signal.SIGHUP, before)
    assert signal.SIGHUP in ending_signals()
