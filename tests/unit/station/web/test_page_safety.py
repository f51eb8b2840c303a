"""When the page may drive and when it must stop: station/web/src/drive/safety.ts in Node, without a browser."""

from __future__ import annotations

import pytest

from station.web import build_hook


def test_the_pages_rules_of_driving_hold() -> None:
    try:
        failures = build_hook.test()
    except build_hook.PageNotBuilt as exc:
        pytest.skip(f"the page's rules need Node: {exc}")
    assert not failures, failures
