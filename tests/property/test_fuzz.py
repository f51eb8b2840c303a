"""A short run of benchmarks/bench_fuzz.py; the long one has a million inputs each."""

import pytest

from tests.support import fuzzing


@pytest.mark.parametrize("seed", [1, 2])
def test_damaged_serial_input_never_harms_the_reader(seed: int) -> None:
    result = fuzzing.fuzz_serial_reader(5000, seed)
    assert result["refused"] > 500 and result["understood"] > 100


@pytest.mark.parametrize("seed", [1, 2])
def test_damaged_stations_neither_harm_the_session_nor_drive_unasked(seed: int) -> None:
    result = fuzzing.fuzz_tcp_decoder(3000, seed)
    assert result["broke_rules"] > 300 and result["drives"] > 100 and result["drives_unjoined"] == 0
