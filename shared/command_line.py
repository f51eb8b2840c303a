"""How a program of ours ends: with 0, or with one sentence on stderr and another code."""

from __future__ import annotations

import errno
import sys
from collections.abc import Sequence

import typer

from shared.advice import complete
from shared.bounded import shortened
from shared.errors import RobotSystemError
from shared.text import printable

# Typer carries its own copy of Click, so the base of its mistakes in usage has no public name of its own.
USAGE_ERROR: type[Exception] = typer.BadParameter.__mro__[1]
BAD_USAGE = 2  # exit code, as shells and Click have it
# What a disk may be at any moment; other errors of the system are mistakes of ours, and keep their traceback.
UNWRITABLE = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO}
WHERE = ("--data", "--config", "--folder")  # options that say where data are: a command that is advised needs them too


def run_program(app: typer.Typer, name: str) -> None:
    """Run the command that argv names, and exit. Neither a traceback nor a box: scripts and people read one line."""
    try:
        sys.exit(app(prog_name=name, standalone_mode=False))
    except USAGE_ERROR as exc:
        sys.exit(_refuse(exc, name))
    except RobotSystemError as exc:
        print(f"{name}: {printable(complete(str(exc), name, _where(sys.argv)))}", file=sys.stderr)  # files are quoted
        sys.exit(1)
    except OSError as exc:
        if exc.errno == errno.ENAMETOOLONG:
            print(
                f"{name}: {printable(shortened(str(exc.filename)))} is too long a name; name another", file=sys.stderr
            )
            sys.exit(1)
        if exc.errno not in UNWRITABLE:
            raise
        what = f"{exc.filename} cannot be used" if exc.filename else "a file cannot be written"
        print(f"{name}: {what} ({exc.strerror}); make room, or choose another place", file=sys.stderr)
        sys.exit(1)
    except typer.Abort:
        sys.exit(1)


def _where(words: Sequence[str]) -> dict[str, str]:
    """What the command line says of where data are."""
    given: dict[str, str] = {}
    for word, following in zip(words, [*words[1:], ""], strict=True):
        name, _, value = word.partition("=")
        if name in WHERE:
            given[name] = value or following
    return given


def _refuse(exc: Exception, name: str) -> int:
    context = getattr(exc, "ctx", None)
    if type(exc).__name__ == "NoArgsIsHelpError":  # not a mistake, only nothing asked
        print(context.get_help() if context is not None else exc, file=sys.stderr)
        return BAD_USAGE
    what = str(exc.format_message()) if hasattr(exc, "format_message") else str(exc)
    what = " ".join(what.split()).rstrip(".")
    where = getattr(context, "command_path", name)
    print(f"{name}: {what[:1].lower()}{what[1:]}; {where} --help tells what can be given", file=sys.stderr)
    return BAD_USAGE
