"""Known holes in what is installed, by a copy of the PyPA advisory database: for machines that reach no service.

    git clone https://github.com/pypa/advisory-database DIR
    make audit ADVISORIES=DIR

Exit code 1: a hole. 3: none, but the copy is too old to say so of today.
"""

from __future__ import annotations

import argparse
import datetime
import importlib.metadata
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from packaging.version import InvalidVersion, Version

FRESH_DAYS = 30
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def normalised(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def installed() -> dict[str, Version]:
    """Every package of this environment."""
    found = {}
    for distribution in importlib.metadata.distributions():
        try:
            found[normalised(distribution.metadata["Name"])] = Version(distribution.version)
        except InvalidVersion:
            print(f"audit: the version of {distribution.metadata['Name']} is none: {distribution.version}")
    return found


def is_affected(version: Version, affected: dict[str, Any]) -> bool:
    """Whether an OSV "affected" entry means this version."""
    if str(version) in affected.get("versions", ()):
        return True
    for span in affected.get("ranges", ()):
        if span["type"] != "ECOSYSTEM":
            continue
        is_in = False
        for event in span["events"]:  # in order: introduced, fixed, introduced …
            if "introduced" in event:
                is_in |= event["introduced"] == "0" or version >= Version(event["introduced"])
            elif "fixed" in event:
                is_in &= version < Version(event["fixed"])
            elif "last_affected" in event:
                is_in &= version <= Version(event["last_affected"])
        if is_in:
            return True
    return False


def advisories(folder: Path) -> Iterator[dict[str, Any]]:
    """Those that still count."""
    for path in sorted(folder.rglob("*.yaml")):
        advisory = yaml.load(path.read_text(encoding="utf-8"), LOADER)  # noqa: S506  # both loaders are safe ones
        if not advisory.get("withdrawn"):
            yield advisory


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("copy", type=Path, help="folder of the database: the one with vulns/ in it")
    parser.add_argument("--ignore", action="append", default=[], help="id of an advisory that does not concern us")
    arguments = parser.parse_args()
    vulns = arguments.copy / "vulns"
    if not vulns.is_dir():
        sys.exit(f"audit: {vulns} is no folder; give a copy of the PyPA advisory database")
    packages = installed()
    newest = datetime.date.min
    looked_at = holes = 0
    for folder in sorted(vulns.iterdir()):
        version = packages.get(normalised(folder.name))
        for advisory in advisories(folder):
            newest = max(newest, datetime.date.fromisoformat(str(advisory["modified"])[:10]))
            if version is None or {advisory["id"], *advisory.get("aliases", ())} & set(arguments.ignore):
                continue
            looked_at += 1
            if any(is_affected(version, affected) for affected in advisory["affected"]):
                holes += 1
                print(f"audit: {folder.name} {version}: {advisory['id']}")
    if holes:
        sys.exit(1)
    print(
        f"audit: none of {looked_at} advisories on the {len(packages)} installed packages concerns the installed"
        f" versions; the newest advisory of this copy is of {newest:%d %B %Y}"
    )
    if (datetime.datetime.now(datetime.UTC).date() - newest).days > FRESH_DAYS:
        print("audit: what became known since is not in it; get a newer copy")
        sys.exit(3)


if __name__ == "__main__":
    main()
