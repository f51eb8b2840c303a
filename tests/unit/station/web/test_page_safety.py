"""When the page may drive and must stop, and where its view reaches: station/web/tests in Node, without a browser."""

from __future__ import annotations

import os

import pytest

from station.web import build_hook


def test_the_pages_rules_of_driving_hold() -> None:
    try:
        failures = build_hook.test()
    except build_hook.PageNotBuilt as exc:
        if os.environ.get("NO_NODE"):
            pytest.skip(f"NO_NODE is set: {exc}")
        pytest.fail(f"the page's rules of driving are not tested: {exc}. Where there is no Node, set NO_NODE=1")
    assert not failures, failures
