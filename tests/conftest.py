"""Settings for all tests."""

import gc
import os
import signal
from collections.abc import Generator, Iterator
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


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Keep the garbage collector from all tests and what they import: going over these took 7 % of the CPU time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--share", type=Path, metavar="FOLDER", help="run no file that another process with it runs")


def pytest_configure(config: pytest.Config) -> None:
    if folder := config.getoption("share"):
        config.pluginmanager.register(Share(folder))


class Share:
    """Which files of tests are run here: those that no other process with the same folder was the first to come to."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._is_ours: dict[Path, bool] = {}

    def _take(self, path: Path) -> bool:
        name = "-".join(path.relative_to(Path(__file__).parent).parts)
        try:
            os.close(os.open(self._folder / name, os.O_CREAT | os.O_EXCL))
        except FileExistsError:
            return False
        return True

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
        if item.path not in self._is_ours:
            self._is_ours[item.path] = self._take(item.path)
        if self._is_ours[item.path]:
            return None
        # What was set up for the last one that ran here, such as its folder, may be no part of the next one.
        item.session._setupstate.teardown_exact(nextitem)
        return True  # anything but None: this test is done with


@pytest.fixture(scope="session")
def textures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where simulated robots keep the textures of their flats: painting them takes a second of each start."""
    return tmp_path_factory.mktemp("textures")


@pytest.fixture
def started_by_a_shell() -> Iterator[None]:
    """SIGHUP as a shell leaves it: where the tests run under `nohup`, the programs they start would outlive it."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)
