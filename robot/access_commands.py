"""`robot-server access …` and `robot-server pair`: who may connect to this robot."""

from __future__ import annotations

import datetime
import json
import socket
import time
from pathlib import Path
from typing import Annotated, Literal

import typer

from robot.access import Gate, check_folder, pairing_sentence, settings_folder
from robot.config import load_config
from robot.pairing import CODE_LIFE_S
from shared.access import Role
from shared.certificates import CERTIFICATE_NAME, make_identity, show_fingerprint
from shared.discovery import DEFAULT_PORT
from shared.pairing import show_code
from shared.token_book import TokenBook
from shared.token_lines import revoke_token, show_tokens

CERTIFICATE_DAYS = 7300  # stations know it by its fingerprint and look at no date

cli = typer.Typer(add_completion=False, pretty_exceptions_enable=False, no_args_is_help=True)
access = typer.Typer(no_args_is_help=True, help="Who may connect to this robot.")
cli.add_typer(access, name="access")

Folder = Annotated[Path | None, typer.Option(help="Where key and tokens are; else as in --config.")]
Config = Annotated[Path | None, typer.Option(help="robot-server's TOML file, for its access.folder and port.")]
Json = Annotated[bool, typer.Option("--json", help="One JSON object as the last line.")]


@access.command()
def init(
    folder: Folder = None,
    config: Config = None,
    renew: Annotated[bool, typer.Option("--renew", help="A new certificate: all stations must pair again.")] = False,
) -> None:
    """Make this robot's key, certificate and empty book of tokens; what is there already stays."""
    place = _folder(folder, config)
    TokenBook.create(place)
    if renew or not (place / CERTIFICATE_NAME).exists():
        name = socket.gethostname() or "robot"
        now = datetime.datetime.now(datetime.UTC)
        make_identity(place, f"Sentinel robot {name}", [name, f"{name}.local"], CERTIFICATE_DAYS, now)
    print(f"certificate {show_fingerprint(Gate(place).fingerprint)}; key and tokens are in {place}")


@cli.command()
def pair(
    folder: Folder = None,
    config: Config = None,
    role: Annotated[Literal["watch", "drive"], typer.Option(help="What the station that pairs may do.")] = "drive",
    as_json: Json = False,
) -> None:
    """Show a code that one station can pair with, for ten minutes; robot-server may run meanwhile."""
    gate = Gate(_folder(folder, config))
    code = gate.desk.open_code(Role(role), time.time())
    if as_json:
        print(json.dumps({"code": show_code(code), "seconds": CODE_LIFE_S, "fingerprint": gate.fingerprint.hex()}))
        return
    port = DEFAULT_PORT if config is None else load_config(config, {}).server.port or DEFAULT_PORT
    print(pairing_sentence(code, port=port))


@access.command("list")
def list_tokens(folder: Folder = None, config: Config = None, as_json: Json = False) -> None:
    """Stations that may connect, and those that no longer may."""
    show_tokens(TokenBook(_folder(folder, config)), as_json)


@access.command()
def revoke(
    name: Annotated[str, typer.Argument(help="Name or id, as `access list` shows it.")],
    folder: Folder = None,
    config: Config = None,
) -> None:
    """A station may connect no longer; its open connection is closed within a second."""
    revoke_token(TokenBook(_folder(folder, config)), name)


def _folder(folder: Path | None, config: Path | None) -> Path:
    if folder is not None:
        return check_folder(folder.expanduser(), "--folder")
    return settings_folder(load_config(config, {}).access)
