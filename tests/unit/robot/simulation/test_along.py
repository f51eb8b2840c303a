"""States along which to render come from the same kind of table as every recording."""

from pathlib import Path

import numpy as np
import pytest

from robot.simulation.along import read_states
from shared.errors import DataError

STATE = "0,0,0,1,0,0,0,0.5,0,0"  # position, quaternion, velocity


def test_biases_may_be_left_out(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    path.write_text(f"#t,p,q,v,bw,ba\n5,{STATE}\n10,{STATE},1,2,3,4,5,6\n")
    table = read_states(path)
    assert table.t_ns.tolist() == [5, 10]
    np.testing.assert_array_equal(table.values[:, 10:], [[0] * 6, [1, 2, 3, 4, 5, 6]])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (f"5,{STATE}\n", "at least two"),
        (f"5,{STATE}\n5,{STATE}\n", "line 2 is not later"),
        (f"{10**19},{STATE}\n", "no time in ns"),
        ("5,1,2\n", "has 3 columns"),
        (f"5,{STATE.replace('0.5', 'fast')}\n", "does not hold numbers"),
        ("\0" * 200_000, "cannot be read"),
    ],
)
def test_a_damaged_table_is_one_sentence(tmp_path: Path, content: str, said: str) -> None:
    (tmp_path / "data.csv").write_text(content)
    with pytest.raises(DataError, match=said):
        read_states(tmp_path / "data.csv")
