"""What may be in a message: bounded numbers, and text that a terminal, a log or a page can show."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import pytest
from msgspec import inspect

from shared.calibration import REFERENCE_ROBOT
from shared.errors import RemoteProtocolError
from shared.message_codec import decode_robot_message, decode_station_message, encode_message
from shared.messages import (
    PROTOCOL_VERSION,
    CalibrationOrigin,
    Capabilities,
    DriveApplied,
    ErrorNotice,
    Hello,
    Join,
    Refusal,
    RobotMessage,
    StationMessage,
    Status,
)
from shared.text import PRINTABLE, SEEN_WHOLE, is_printable, printable

FORGED = "\x1b[2J\x1b]0;owned\x07done\r\nINFO link: connected to Anna\u202e\u2028"
SENTENCES = {"error.message", "refusal.reason", "status.faults[]"} | {
    f"{where}.{field}"
    for where in ("hello.calibration_origin", "calibration_changed.origin")
    for field in ("source", "fixed")
}
HELLO = Hello(
    protocol=PROTOCOL_VERSION,
    robot_id="r",
    name="R",
    session_id="s",
    capabilities=Capabilities(camera=True, imu=True, drive=True, pan_tilt=False, battery=False, hijack=False),
    calibration=REFERENCE_ROBOT,
)


def parts(kind: inspect.Type, path: str = "") -> Iterator[tuple[str, inspect.Type]]:
    """All that a message is made of, with where it stands."""
    yield path, kind
    match kind:
        case inspect.StructType():
            prefix = f"{path}." if path else f"{kind.tag}."
            for field in kind.fields:
                yield from parts(field.type, f"{prefix}{field.name}")
        case inspect.UnionType():
            for one in kind.types:
                yield from parts(one, path)
        case inspect.VarTupleType():
            yield from parts(kind.item_type, f"{path}[]")
        case inspect.TupleType():
            for number, one in enumerate(kind.item_types):
                yield from parts(one, f"{path}[{number}]")
        case inspect.DictType():
            yield from parts(kind.key_type, f"{path}{{key}}")
            yield from parts(kind.value_type, f"{path}{{}}")


ALL_PARTS = [*parts(inspect.type_info(RobotMessage)), *parts(inspect.type_info(StationMessage))]


def test_every_whole_number_in_a_message_has_bounds_that_fit_a_signed_64_bit_word() -> None:
    numbers = [(path, kind) for path, kind in ALL_PARTS if isinstance(kind, inspect.IntType)]
    assert len(numbers) > 20
    for path, kind in numbers:
        assert kind.ge is not None and kind.ge >= -(2**62), path
        assert kind.le is not None and kind.le <= 2**62, path


def test_every_text_in_a_message_is_a_printable_name_or_a_sentence() -> None:
    texts = [(path, kind) for path, kind in ALL_PARTS if isinstance(kind, inspect.StrType)]
    assert len(texts) > 10
    for path, kind in texts:
        assert kind.max_length is not None, path
        assert kind.pattern in (PRINTABLE, SEEN_WHOLE) or path in SENTENCES, path


@pytest.mark.parametrize(
    "message",
    [ErrorNotice(code="device", message="x"), Refusal(reason="x"), Status(t_robot_ns=1, uptime_s=1.0, faults=("x",))],
    ids=lambda message: type(message).__name__,
)
def test_only_printable_sentences_leave_the_decoder(message: RobotMessage) -> None:
    plain = msgspec.msgpack.decode(encode_message(message))
    forged = {k: FORGED if v == "x" else [FORGED] if v == ["x"] else v for k, v in plain.items()}
    heard = decode_robot_message(msgspec.msgpack.encode(forged))
    said = [getattr(heard, key) for key in ("message", "reason", "faults") if hasattr(heard, key)]
    text = "".join(said[0])
    assert is_printable(text) and len(text) == len(FORGED) and "INFO link: connected to Anna" in text


def test_what_a_robot_says_of_its_calibration_is_printable() -> None:
    forged = msgspec.structs.replace(HELLO, calibration_origin=CalibrationOrigin(source="x", fixed="y"))
    plain = msgspec.msgpack.decode(encode_message(forged))
    plain["calibration_origin"] |= {"source": FORGED, "fixed": FORGED}
    heard = decode_robot_message(msgspec.msgpack.encode(plain))
    assert isinstance(heard, Hello) and heard.calibration_origin is not None
    assert is_printable(heard.calibration_origin.source) and is_printable(heard.calibration_origin.fixed)


@pytest.mark.parametrize("name", [FORGED, "a\x00", "a\n", "\x9b2J", "\u202egpj.exe"])
def test_names_with_control_characters_are_refused_and_not_repeated(name: str) -> None:
    for message, decode in (
        (msgspec.structs.replace(HELLO, name=name), decode_robot_message),
        (msgspec.structs.replace(HELLO, robot_id=name), decode_robot_message),
        (Join(protocol=PROTOCOL_VERSION, station_name=name), decode_station_message),
    ):
        with pytest.raises(RemoteProtocolError, match=r"printable characters|characters that can be seen") as refused:
            decode(encode_message(message))
        assert is_printable(str(refused.value))


@pytest.mark.parametrize("robot_id", ["rover\u200b", "\u2800", "ro\xadver", "  "])
def test_an_id_that_looks_like_another_one_is_refused(robot_id: str) -> None:
    plain = msgspec.msgpack.decode(encode_message(HELLO)) | {"robot_id": robot_id}
    with pytest.raises(RemoteProtocolError, match=r"can be seen|is seen"):
        decode_robot_message(msgspec.msgpack.encode(plain))


def test_names_in_any_alphabet_are_taken() -> None:
    for name in ("Küche", "居间", "می\u200cخواهم", "👩\u200d🚀", "two words"):
        said = msgspec.structs.replace(HELLO, name=name)
        assert decode_robot_message(encode_message(said)) == said


def test_what_is_quoted_of_a_damaged_message_is_printable_and_short() -> None:
    for sent in ({"type": FORGED}, {"type": FORGED * 1000}):
        with pytest.raises(RemoteProtocolError) as refused:
            decode_robot_message(msgspec.msgpack.encode(sent))
        assert is_printable(str(refused.value)) and len(str(refused.value)) < 400


@pytest.mark.parametrize("number", [2**63 - 1, 2**64 - 1, -(2**63)])
def test_numbers_beyond_their_bounds_are_refused(number: int) -> None:
    with pytest.raises(RemoteProtocolError, match="not a valid message"):
        decode_station_message(msgspec.msgpack.encode({"type": "heartbeat", "seq": 1, "t_station_ns": number}))
    with pytest.raises(RemoteProtocolError, match="not a valid message"):
        decode_robot_message(msgspec.msgpack.encode({"type": "status", "t_robot_ns": number, "uptime_s": 1.0}))


def test_what_cannot_be_shown_is_seen_to_have_been_there() -> None:
    assert printable("a\x1bb\nc") == "a\N{REPLACEMENT CHARACTER}b\N{REPLACEMENT CHARACTER}c"


NO_NUMBERS = (float("nan"), float("inf"), -float("inf"))


@pytest.mark.parametrize("number", NO_NUMBERS)
def test_what_a_robot_measures_as_no_number_is_not_known(number: float) -> None:
    told = Status(
        t_robot_ns=1,
        uptime_s=number,
        battery_v=number,
        battery_fraction=number,
        cpu_percent=number,
        temperatures_c={"cpu": number, "board": 40.0},
    )
    known = Status(t_robot_ns=1, uptime_s=0.0, temperatures_c={"board": 40.0})
    assert told == known == decode_robot_message(encode_message(told))


@pytest.mark.parametrize("number", NO_NUMBERS)
@pytest.mark.parametrize("field", ["linear", "angular"])
def test_motors_are_told_numbers(field: str, number: float) -> None:
    raw = {"type": "drive_applied", "t_robot_ns": 1, "linear": 0.1, "angular": 0.0, field: number}
    with pytest.raises(RemoteProtocolError, match="is no motion"):
        decode_robot_message(msgspec.msgpack.encode(raw))
    assert isinstance(decode_robot_message(msgspec.msgpack.encode(raw | {field: 0.2})), DriveApplied)


@pytest.mark.parametrize("number", [*NO_NUMBERS, 1e9])
@pytest.mark.parametrize("field", ["max_linear_m_s", "max_angular_rad_s"])
def test_a_robot_is_as_fast_as_a_command_can_say(field: str, number: float) -> None:
    raw = msgspec.to_builtins(HELLO)
    raw["capabilities"][field] = number
    with pytest.raises(RemoteProtocolError, match=f"{field} .* is outside"):
        decode_robot_message(msgspec.msgpack.encode(raw))


@pytest.mark.parametrize("name", [" ", "\u200b", "\u2800\u3164", "\u00a0", "\ufe0f"])
def test_a_robot_of_whose_name_nothing_is_seen_is_refused(name: str) -> None:
    said = msgspec.msgpack.decode(encode_message(HELLO))
    with pytest.raises(RemoteProtocolError, match="no character that is seen"):
        decode_robot_message(msgspec.msgpack.encode(said | {"name": name}))


@pytest.mark.parametrize("name", ["Rosa\u200b", " Rosa", "\u0645\u06cc\u200c\u0631\u0648\u062f"])
def test_a_robots_name_from_before_is_taken_as_it_is(name: str) -> None:
    said = msgspec.msgpack.decode(encode_message(HELLO))
    heard = decode_robot_message(msgspec.msgpack.encode(said | {"name": name}))
    assert isinstance(heard, Hello) and heard.name == name
