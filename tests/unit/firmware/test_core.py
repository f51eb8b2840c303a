"""firmware/core on this PC, under address and undefined-behaviour sanitizers, against the golden bytes."""

import shutil
import subprocess

import pytest

from tests.support.paths import ROOT


@pytest.mark.skipif(
    shutil.which("g++") is None or shutil.which("make") is None, reason="firmware core tests need g++ and make"
)
def test_firmware_core_passes_its_own_tests() -> None:
    run = subprocess.run(["make", "-s", "-C", str(ROOT / "firmware"), "test"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("ok test_") >= 20
