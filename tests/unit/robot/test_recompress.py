"""Pictures made smaller for thin links are the same pictures."""

from __future__ import annotations

import builtins
from typing import Any

import cv2
import numpy as np
import pytest

from robot.recompress import recompress


def scene(seed: int = 0) -> bytes:
    coarse = np.random.default_rng(seed).integers(0, 255, (60, 80, 3), np.uint8)
    image = cv2.resize(coarse, (640, 480), interpolation=cv2.INTER_CUBIC)
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])[1])


def image_of(jpeg: bytes) -> Any:
    return cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR).astype(int)


def without(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    own_import = builtins.__import__

    def refuse(name: str, *rest: Any, **options: Any) -> Any:
        if name.partition(".")[0] in names:
            raise ImportError(name)
        return own_import(name, *rest, **options)

    monkeypatch.setattr(builtins, "__import__", refuse)


@pytest.mark.parametrize("missing", [(), ("cv2",)])
def test_a_lower_quality_is_smaller_and_shows_the_same(
    monkeypatch: pytest.MonkeyPatch, missing: tuple[str, ...]
) -> None:
    jpeg = scene()
    whole = image_of(jpeg)
    without(monkeypatch, *missing)
    good, poor = recompress(jpeg, 50), recompress(jpeg, 20)
    monkeypatch.undo()
    assert len(poor) < len(good) < len(jpeg)
    assert image_of(poor).shape == (480, 640, 3)
    assert np.abs(image_of(poor) - whole).mean() < 12


def test_what_is_no_picture_or_gets_no_smaller_stays_as_it_was() -> None:
    assert recompress(b"no picture", 20) == b"no picture"
    poor = recompress(scene(), 10)
    assert recompress(poor, 95) is poor


def test_without_any_library_pictures_stay_as_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    jpeg = scene()
    without(monkeypatch, "cv2", "PIL")
    assert recompress(jpeg, 20) is jpeg
