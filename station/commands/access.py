"""`station access …`, `station pair` and `station robots`: who may use this station, and which robots it trusts."""

from __future__ import annotations

import asyncio
import contextlib
import datetime
import json
import socket
import sys
import time
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import urlsplit

import typer

from shared.access import Role, Token
from shared.advice import complete, option
from shared.bounded import shown
from shared.certificates import CERTIFICATE_NAME, make_identity, open_identity, show_fingerprint
from shared.errors import ConfigError
from shared.listening import show_address
from shared.pairing import parse_code
from shared.text import is_printable
from shared.token_book import TokenBook, TokenRecord
from shared.token_lines import revoke_token, show_tokens
from station.access.expiry import expiry_sentence
from station.access.paired_robots import PairedRobot, PairedRobots
from station.access.pairing import confirm
from station.access.pairing import pair as pair_with
from station.access.visitors import LINK_S, MAX_TOKEN_DAYS, access_folder
from station.commands.options import Config, Data, Json, data_folder
from station.config import load_config, parse_address

CERTIFICATE_DAYS = 820  # some browsers take no longer one
FIRST = "owner"

access = typer.Typer(no_args_is_help=True, help="Who may use this station.")


def register(app: typer.Typer) -> None:
    app.add_typer(access, name="access")
    app.command()(pair)
    app.command()(robots)


@access.command()
def init(
    data: Data = None,
    config: Config = None,
    name: Annotated[list[str] | None, typer.Option(help="A further name or address that browsers use.")] = None,
    renew: Annotated[bool, typer.Option("--renew", help="A new certificate; tokens stay.")] = False,
    as_json: Json = False,
) -> None:
    """Make this station's certificate and the first admin token, which is shown once; what is there already stays."""
    folder = _folder(data, config)
    book = TokenBook.create(folder)
    if renew or not (folder / CERTIFICATE_NAME).exists():
        _make_certificate(folder, name or [])
    identity = open_identity(folder)
    token = None if book.has_live_token(time.time()) else book.add(FIRST, Role.ADMIN, time.time()).text
    _say_if_nobody_is_admin(book, data, config)
    if as_json:
        certificate = str(identity.certificate)
        print(json.dumps({"token": token, "fingerprint": identity.fingerprint.hex(), "certificate": certificate}))
        return
    print(f"certificate {identity.certificate}, fingerprint {show_fingerprint(identity.fingerprint)}")
    if token is not None:
        _show_token(token, FIRST, Role.ADMIN)


@access.command()
def add(
    name: Annotated[str, typer.Argument(help="Who or what it is for, such as anna or garden-display.")],
    role: Annotated[
        Literal["watch", "drive", "admin"],
        typer.Option(help="watch; drive: also move, record, name; admin: also delete."),
    ],
    data: Data = None,
    config: Config = None,
    days: Annotated[
        float | None, typer.Option(min=0.001, max=MAX_TOKEN_DAYS, help="It ends by itself after so many days.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Make a token for somebody; it is shown once."""
    book = TokenBook(_folder(data, config))
    token = book.add(name, Role(role), time.time(), None if days is None else days * 86_400).text
    if as_json:
        print(json.dumps({"name": name, "role": role, "token": token}))
        return
    _show_token(token, name, Role(role))


@access.command()
def link(
    name: Annotated[str, typer.Argument(help="Whose token: name or id.")],
    address: Annotated[str, typer.Option(help="Where the page is, such as https://192.168.1.20:8080.")] = "",
    data: Data = None,
    config: Config = None,
) -> None:
    """A link that logs one browser in, once, within ten minutes: for a phone that cannot paste a token."""
    if address and not _is_page(address):
        raise ConfigError(
            f"--address {shown(address)} is no page's address; give one such as https://192.168.1.20:8080"
        )
    book, now_s = TokenBook(_folder(data, config)), time.time()
    code = book.add_for(_one(book, name, now_s), "link", now_s, LINK_S).text
    where = address.rstrip("/") or f"https://{socket.gethostname()}:8080"
    print(f"{where}/#login={code}")


@access.command("list")
def list_tokens(data: Data = None, config: Config = None, as_json: Json = False) -> None:
    """Who may, and who no longer may; says when the certificate is about to expire."""
    folder = _folder(data, config)
    show_tokens(TokenBook(folder), as_json)
    identity = open_identity(folder) if (folder / CERTIFICATE_NAME).exists() else None
    if sentence := expiry_sentence(identity, datetime.datetime.now(datetime.UTC)):
        typer.echo(f"warning: {complete(sentence, 'station', {'--data': data, '--config': config})}", err=True)


@access.command()
def revoke(
    name: Annotated[str, typer.Argument(help="Name or id, as `access list` shows it.")],
    data: Data = None,
    config: Config = None,
) -> None:
    """A token counts no longer; what it has open is closed within a second."""
    book = TokenBook(_folder(data, config))
    revoke_token(book, name)
    _say_if_nobody_is_admin(book, data, config)


def pair(
    robot: Annotated[str, typer.Argument(help="HOST or HOST:PORT of robot-server.")],
    code: Annotated[str, typer.Option(help="The code that the robot shows: `robot-server pair`.")],
    data: Data = None,
    config: Config = None,
    as_json: Json = False,
) -> None:
    """Pair with a robot: its code becomes a token, and its certificate is remembered."""
    settings = load_config(config)
    host, port = parse_address(robot, "ROBOT")
    station_name = f"{settings.name} on {socket.gethostname() or 'a PC'}"
    known, digits = _robots(data, config), parse_code(code)
    known.check_writable()
    paired = asyncio.run(pair_with(host, port, digits, station_name))
    before = known.store(paired)
    if unconfirmed := asyncio.run(confirm(paired)):
        print(unconfirmed, file=sys.stderr)
    for other in before:
        print(_lost_its_address(other, paired), file=sys.stderr)
    fingerprint = show_fingerprint(bytes.fromhex(paired.fingerprint))
    if as_json:
        print(json.dumps({"robot": paired.name, "host": host, "port": port, "fingerprint": paired.fingerprint}))
        return
    where = f"{show_address(host, port)}{option('--data', data)}{option('--config', config)}"
    print(f"paired with {paired.name} (certificate {fingerprint}); connect with: station serve --robot {where}")


def robots(
    data: Data = None,
    config: Config = None,
    forget: Annotated[
        str | None, typer.Option(help="Robot not to trust any more: its name, or certificate's beginning.")
    ] = None,
    as_json: Json = False,
) -> None:
    """The robots this station is paired with."""
    paired = _robots(data, config)
    if forget is not None:
        print(_forgotten(paired.forget(forget)), file=sys.stderr)
    known = [(r.name, r.host, r.port, r.fingerprint) for r in paired.all()]
    if as_json:
        print(json.dumps([dict(zip(("name", "host", "port", "fingerprint"), r, strict=True)) for r in known]))
        return
    for name, host, port, fingerprint in known:
        address = show_address(host, port) if host else "address unknown"
        print(f"{name}  {address}  certificate {show_fingerprint(bytes.fromhex(fingerprint))}")
    if not known:
        print("none")


def _forgotten(robot: PairedRobot) -> str:
    """What became of a robot's token: here it is gone, and the robot is not asked, which may be off or elsewhere."""
    who = f"{robot.name} (certificate {robot.short_certificate})"
    token = Token.parse(robot.token)
    said = f"{who} is forgotten: its certificate and this station's token for it are gone from here"
    if token is None:
        return f"{said}; `robot-server access list` on the robot shows what still counts there"
    return f"{said}; on the robot that token counts until somebody runs `robot-server access revoke {token.id}` there"


def _lost_its_address(other: PairedRobot, paired: PairedRobot) -> str:
    """What became of the robot that was at the address of the one that was just paired."""
    who = f"{other.name} (certificate {show_fingerprint(bytes.fromhex(other.fingerprint))})"
    if other.robot_id == paired.robot_id:
        return f"{who}, with the same id, was paired at {paired.address} before and is replaced"
    return (
        f"{who} was paired at {paired.address} before and is no longer looked for there: it stays paired, so give its"
        " new address, or auto, to `station serve --robot`"
    )


def _make_certificate(folder: Path, names: list[str]) -> None:
    host = socket.gethostname() or "station"
    known = ["localhost", "127.0.0.1", "::1", host, f"{host}.local", *_own_addresses(), *names]
    now = datetime.datetime.now(datetime.UTC)
    make_identity(folder, f"Sentinel station {host}", known, CERTIFICATE_DAYS, now)


def _own_addresses() -> list[str]:
    """Addresses that this machine's name stands for, and the one it would reach others by; nothing is sent."""
    found: list[str] = []
    with contextlib.suppress(OSError):  # a machine without a name of its own
        found += [str(a[0]).partition("%")[0] for *_, a in socket.getaddrinfo(socket.gethostname(), None)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):  # no network
        probe.connect(("192.0.2.1", 9))  # an address for documentation: only the route is looked up
        found.append(str(probe.getsockname()[0]))
    return found


def _show_token(token: str, name: str, role: Role) -> None:
    print(f"token of {name} ({role.value}), shown only now:\n{token}")


def _say_if_nobody_is_admin(book: TokenBook, data: Path | None, config: Path | None) -> None:
    """`access init` makes an admin only where nobody may anything."""
    now_s = time.time()
    if book.has_live_token(now_s, Role.ADMIN):
        return
    way = "`access add NAME --role admin`" if book.has_live_token(now_s) else "`access init`"
    sentence = f"no admin is left, who may delete, pair and let others in over the page; {way} makes one"
    typer.echo(complete(sentence, "station", {"--data": data, "--config": config}), err=True)


def _is_page(address: str) -> bool:
    """Whether it is an http or https URL of a host, behind which `#login=…` may stand."""
    try:
        url = urlsplit(address)
        port = url.port  # read, it is checked
    except ValueError:
        return False
    is_clean = is_printable(address) and not any(map(str.isspace, address)) and not {"?", "#"} & set(address)
    return url.scheme in ("http", "https") and bool(url.hostname) and port != 0 and is_clean


def _one(book: TokenBook, name: str, now_s: float) -> TokenRecord:
    for record in book.tokens():
        if record.is_live(now_s) and name in (record.name, record.id):
            return record
    raise ConfigError(
        f"nobody named {name!r} may; `station access list` shows who may, `station access add NAME --role …` lets"
        " somebody in"
    )


def _folder(data: Path | None, config: Path | None) -> Path:
    return access_folder(data_folder(data, load_config(config)))


def _robots(data: Path | None, config: Path | None) -> PairedRobots:
    return PairedRobots(_folder(data, config))
