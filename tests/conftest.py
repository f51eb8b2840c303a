"""Settings for all tests."""

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

COMPUTING = {"unit", "property", "golden"}  # folders; of the other tests those that are marked so

# A slow machine is not a wrong result: Hypothesis' limit of 200 ms per example would fail tests at random.
settings.register_profile("sentinel", deadline=None)
settings.load_profile("sentinel")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what `scripts/test.sh` lets give way to the rest, before tests are chosen by their marks."""
    for item in items:
        if item.path.relative_to(Path(__file__).parent).parts[0] in COMPUTING:
            item.add_marker(pytest.mark.computing)


@pytest.fixture
def started_by_a_shell() -> Iterator[None]:
    """SIGHUP as a shell leaves it: where the tests run under `nohup`, the programs they start would outlive it."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)
