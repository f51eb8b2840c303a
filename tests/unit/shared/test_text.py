"""Names of any script, cut to the width that there is for them."""

from __future__ import annotations

import pytest

from shared.text import columns, fitted


@pytest.mark.parametrize(
    ("text", "cut"),
    [
        ("Kitchen", "Kitchen"),
        ("Living room", "Living…"),
        ("The room", "The ro…"),
        ("Children's room", "Childr…"),
        ("子供の部屋", "子供の…"),
        ("Café 1", "Café 1"),
        ("Cafe\u0301s 1", "Cafe\u0301s 1"),  # the accent is a sign of its own, and takes no space
        ("", ""),
    ],
)
def test_a_text_is_cut_where_it_would_be_wider_than_its_space(text: str, cut: str) -> None:
    assert fitted(text, 7) == cut
    assert columns(cut) <= 7
