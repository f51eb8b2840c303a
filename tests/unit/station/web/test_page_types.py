"""The page's TypeScript types are those of the API's models, and its lock file names no registry."""

from __future__ import annotations

from station.api.page_types import TARGET, generate
from tests.support.paths import ROOT

WEB = ROOT / "station" / "web"


def test_types_of_the_page_are_current() -> None:
    assert TARGET.read_text() == generate(), "run: python -m station.api.page_types"


def test_lock_file_names_no_registry() -> None:
    assert '"resolved"' not in (WEB / "package-lock.json").read_text()


def test_sources_of_the_page_ask_no_other_host() -> None:
    sources = [WEB / "index.html", *(p for p in (WEB / "src").rglob("*") if p.suffix in (".ts", ".css"))]
    for source in sources:
        text = source.read_text().replace("http://www.w3.org/2000/svg", "")
        assert "http://" not in text and "https://" not in text, source.name
