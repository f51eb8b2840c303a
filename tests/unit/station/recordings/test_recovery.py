"""What `station recordings verify` says of damage, and what `recover` makes of it: no sound chunk is ever lost."""

from __future__ import annotations

import json
from collections import Counter
from io import BytesIO
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Chunk, ChunkIndex, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, IndexType, Writer
from typer.testing import CliRunner

import station.recordings.chunks
from shared.errors import DataError
from shared.mcap_recording import FRAME_TOPIC, HELLO_TOPIC, IMAGE_TOPIC
from station.datasets import open_dataset
from station.library.navigation_records import NavigationLibrary, NavigationRecord
from station.library.recordings import finished_recordings, remove_recording
from station.main import app
from station.recordings.check import check_recording
from station.recordings.chunks import SoundChunk, parts_of
from station.recordings.recorder import Recorder
from station.recordings.recovery import recover_recording
from station.recordings.topics import LIBRARY, register_channels
from station.recordings.writer_lock import hold, is_being_written
from tests.support.datasets import frames_of, imu_of
from tests.support.recordings import HELLO, batch, finish, frame, messages_in, record, recorded_in_small_chunks

Told = tuple[str, int, int, bytes]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return recorded_in_small_chunks(tmp_path_factory.mktemp("rec") / "d.mcap")


@pytest.fixture(scope="module")
def chunks(whole: bytes) -> list[tuple[ChunkIndex, list[Told]]]:
    """The chunks where the reference reader finds them, with what they hold."""
    summary = make_reader(BytesIO(whole)).get_summary()
    assert summary is not None
    found = []
    for index in sorted(summary.chunk_indexes, key=lambda c: c.chunk_start_offset):
        data = whole[index.chunk_start_offset : index.chunk_start_offset + index.chunk_length]
        chunk = next(StreamReader(BytesIO(data), skip_magic=True, emit_chunks=True).records)
        assert isinstance(chunk, Chunk)
        messages = [record for record in breakup_chunk(chunk, validate_crc=True) if isinstance(record, Message)]
        held = [(summary.channels[m.channel_id].topic, m.log_time, m.publish_time, m.data) for m in messages]
        found.append((index, held))
    return found


@settings(max_examples=80, deadline=None)
@given(position=st.floats(0, 0.99999), bit=st.integers(0, 7), length=st.just(1.0) | st.floats(0, 1))
def test_one_flipped_bit_costs_no_sound_chunk(
    whole: bytes,
    chunks: list[tuple[ChunkIndex, list[Told]]],
    tmp_path_factory: pytest.TempPathFactory,
    position: float,
    bit: int,
    length: float,
) -> None:
    damaged = bytearray(whole[: max(1, int(length * len(whole)))])
    flipped = int(position * len(damaged))
    damaged[flipped] ^= 1 << bit
    path = tmp_path_factory.mktemp("flip") / "d.mcap"
    path.write_bytes(damaged)
    sound: Counter[Told] = Counter()
    for index, held in chunks:
        begin, end = index.chunk_start_offset, index.chunk_start_offset + index.chunk_length
        if end <= len(damaged) and not begin <= flipped < end:
            sound.update(held)
    try:
        recovery = recover_recording(path)
    except DataError:
        assert not sound
        assert path.read_bytes() == damaged
        return
    assert Counter(messages_in(path)) >= sound
    assert check_recording(path).damage == ""
    if recovery is not None and recovery.inside:
        assert recovery.original is not None and recovery.original.read_bytes() == damaged


def in_the_middle(index: ChunkIndex) -> int:
    return index.chunk_start_offset + index.chunk_length // 2


def test_a_chunk_that_claims_the_next_ones_bytes_hides_none_of_them(
    whole: bytes, chunks: list[tuple[ChunkIndex, list[Told]]], tmp_path: Path
) -> None:
    path = tmp_path / "d.mcap"
    damaged = bytearray(whole)
    claiming = chunks[4][0]
    size_at = claiming.chunk_start_offset + claiming.chunk_length - claiming.compressed_size - 8
    assert int.from_bytes(damaged[size_at : size_at + 8], "little") == claiming.compressed_size
    damaged[size_at + 1] ^= 0x80  # 32 kB more
    path.write_bytes(damaged)
    recovery = recover_recording(path)
    kB = (chunks[5][0].chunk_start_offset - claiming.chunk_start_offset) / 1000
    assert recovery is not None and recovery.inside == f"1 damaged stretch inside it ({kB:.1f} kB)"
    assert recovery.original is not None and recovery.original.read_bytes() == damaged
    others = Counter[Told]()
    for index, held in chunks:
        if index is not claiming:
            others.update(held)
    assert Counter(messages_in(path)) >= others


def test_a_hole_is_passed_over_and_the_file_as_it_was_is_kept(
    whole: bytes, chunks: list[tuple[ChunkIndex, list[Told]]], tmp_path: Path
) -> None:
    path = tmp_path / "d.mcap"
    damaged = bytearray(whole)
    damaged[in_the_middle(chunks[9][0])] ^= 16
    path.write_bytes(damaged)
    said = CliRunner().invoke(app, ["recordings", "verify", str(path)])
    assert said.exit_code == 1
    assert "1 damaged stretch inside it" in said.output and "no end" not in said.output
    assert f"station recordings recover {path}" in said.output
    recovery = recover_recording(path)
    assert recovery is not None
    kept = tmp_path / "d.mcap.damaged"
    kB = (chunks[10][0].chunk_start_offset - chunks[9][0].chunk_start_offset) / 1000
    assert f"1 damaged stretch inside it ({kB:.1f} kB) could not be read" in str(recovery)
    assert str(kept) in str(recovery) and "end were cut" not in str(recovery)
    assert kept.read_bytes() == damaged
    left = [told for number, (_, held) in enumerate(chunks) if number != 9 for told in held]
    assert messages_in(path) == left and recovery.messages == len(left)
    # Read up to the end, each picture with its own time
    dataset = open_dataset(path)
    pictures = {frame(n).t_robot_ns: frame(n).jpeg for n in range(40)}
    frames = list(frames_of(dataset))
    assert all(pictures[f.t_robot_ns] == f.encoded for f in frames) and frames[-1].encoded == frame(39).jpeg
    assert imu_of(dataset).t_robot_ns.max() == batch(390).samples[-1].t_robot_ns
    # Damaged again: what was kept stays
    again = bytearray(whole)
    again[70_000:90_000] = bytes(20_000)
    path.write_bytes(again)
    recovery = recover_recording(path)
    assert recovery is not None and recovery.original == tmp_path / "d.mcap.damaged.2"
    assert kept.read_bytes() == damaged and recovery.original.read_bytes() == again
    assert sorted(p.name for p in tmp_path.iterdir()) == ["d.mcap", "d.mcap.damaged", "d.mcap.damaged.2"]


def test_a_hole_and_a_cut_end_are_told_apart(
    whole: bytes, chunks: list[tuple[ChunkIndex, list[Told]]], tmp_path: Path
) -> None:
    path = tmp_path / "d.mcap"
    damaged = bytearray(whole[: in_the_middle(chunks[30][0])])
    for number in (5, 6, 20):  # two neighbours are one hole
        damaged[in_the_middle(chunks[number][0])] ^= 1
    path.write_bytes(damaged)
    damage = check_recording(path).damage
    assert damage.startswith("it has no end") and "2 damaged stretches inside it" in damage
    recovery = recover_recording(path)
    assert recovery is not None
    assert recovery.bytes_cut == len(damaged) - chunks[30][0].chunk_start_offset
    assert "kB at its end were cut off; 2 damaged stretches inside it" in str(recovery)
    assert messages_in(path) == [t for n, (_, held) in enumerate(chunks[:30]) if n not in (5, 6, 20) for t in held]


@pytest.mark.parametrize("where", ["between two chunks", "before the end", "at a cut end"])
def test_only_a_record_that_the_files_end_cuts_off_is_called_cut(
    whole: bytes, chunks: list[tuple[ChunkIndex, list[Told]]], tmp_path: Path, where: str
) -> None:
    path = tmp_path / "d.mcap"
    length = {"between two chunks": in_the_middle(chunks[30][0]), "before the end": len(whole)}
    damaged = bytearray(whole[: length.get(where, chunks[30][0].chunk_start_offset)])
    if where == "at a cut end":
        damaged += b"\xff" * 100  # no kind of record
    else:
        index = chunks[20 if where == "between two chunks" else -1][0]
        damaged[index.chunk_start_offset + index.chunk_length + 6] ^= 1  # the length of what follows a chunk
    path.write_bytes(damaged)
    recovery = recover_recording(path)
    assert recovery is not None and recovery.inside and recovery.original is not None


@pytest.mark.parametrize("from_end", [1, 37])  # of the last mark; the kind of the last record
def test_a_damaged_end_is_no_end(whole: bytes, tmp_path: Path, from_end: int) -> None:
    path = tmp_path / "d.mcap"
    damaged = bytearray(whole)
    damaged[-from_end] ^= 0x80
    path.write_bytes(damaged)
    assert check_recording(path).damage.startswith("it has no end")


def test_who_looks_whether_a_file_is_written_keeps_nobody_from_it(tmp_path: Path) -> None:
    path = tmp_path / "d.mcap"
    path.write_bytes(b"")
    with path.open("rb") as reader, path.open("r+b") as writer:
        assert not is_being_written(reader)
        assert hold(writer) and is_being_written(reader)
    with path.open("r+b") as writer:
        assert hold(writer)  # nobody does any more


def test_a_chunk_without_checksum_is_not_believed(tmp_path: Path) -> None:
    path = tmp_path / "d.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.LZ4, enable_crcs=False)
        writer.start(library=LIBRARY)
        writer.add_message(register_channels(writer)[HELLO_TOPIC], 1, b"{}", 1)
        finish(writer)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(DataError, match="nothing that can be recovered"):
        recover_recording(path)


def test_without_its_first_chunk_every_message_keeps_its_topic(
    whole: bytes, chunks: list[tuple[ChunkIndex, list[Told]]], tmp_path: Path
) -> None:
    path = tmp_path / "d.mcap"
    damaged = bytearray(whole)
    damaged[: in_the_middle(chunks[1][0])] = bytes(in_the_middle(chunks[1][0]))  # as a sector that is gone
    path.write_bytes(damaged)
    assert recover_recording(path) is not None
    assert messages_in(path) == [told for _, held in chunks[2:] for told in held]


def test_a_chunk_whose_kind_is_damaged_is_missed_and_found(
    whole: bytes, chunks: list[tuple[ChunkIndex, list[Told]]], tmp_path: Path
) -> None:
    path = tmp_path / "d.mcap"
    damaged = bytearray(whole)
    damaged[chunks[9][0].chunk_start_offset] ^= 0x80  # readers pass over kinds they do not know
    path.write_bytes(damaged)
    total = sum(len(held) for _, held in chunks)
    assert f"{total - len(chunks[9][1])} of {total} messages are found" in check_recording(path).damage
    recovery = recover_recording(path)
    assert recovery is not None and recovery.original is None and recovery.inside == ""
    assert messages_in(path) == [told for _, held in chunks for told in held]


def test_a_damaged_index_is_found_and_made_anew(whole: bytes, tmp_path: Path) -> None:
    path = tmp_path / "d.mcap"
    damaged = bytearray(whole)
    summary = make_reader(BytesIO(whole)).get_summary()
    assert summary is not None
    offset = summary.chunk_indexes[7].chunk_start_offset.to_bytes(8, "little")
    damaged[whole.rindex(offset)] ^= 1  # where a reader that seeks looks for the chunk
    path.write_bytes(damaged)
    assert check_recording(path).damage == "its index is damaged"
    recovery = recover_recording(path)
    assert recovery is not None and recovery.original is None
    sound = tmp_path / "sound.mcap"
    sound.write_bytes(whole)
    assert messages_in(path) == messages_in(sound) and check_recording(path).damage == ""


@pytest.mark.parametrize(
    "content", [b"", b"\x89MCAP0\r\n", bytes(5000), b"something else that is no recording at all" * 9]
)
def test_what_holds_nothing_stays_as_it_is(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "d.mcap"
    path.write_bytes(content)
    assert "recover" not in str(check_recording(path)) and check_recording(path).damage
    with pytest.raises(DataError, match="nothing that can be recovered; it stays as it is"):
        recover_recording(path)
    assert path.read_bytes() == content and list(tmp_path.iterdir()) == [path]


def test_what_is_being_recorded_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "d.mcap"
    path.write_bytes(bytes(300_000))  # what had this name before is gone
    recorder = Recorder(path, min_free_bytes=0)
    recorder.on_connected(HELLO)
    recorder.on_imu(batch(0))
    inode = path.stat().st_ino
    with pytest.raises(DataError, match="is being recorded; end that"):
        recover_recording(path)
    said = CliRunner().invoke(app, ["recordings", "verify", str(path)])
    assert said.exit_code == 0 and "is being written" in said.output and "recover" not in said.output
    with pytest.raises(DataError, match="is being recorded already"):
        Recorder(path, min_free_bytes=0)
    recorder.on_imu(batch(10))
    report = recorder.close()
    assert report.error == "" and path.stat().st_ino == inode
    assert len(imu_of(open_dataset(path))) == 20
    assert str(check_recording(path)).startswith(f"{path}: whole")
    assert recover_recording(path) is None
    record(path, frames=3)  # whoever ended holds nothing any more
    assert len(open_dataset(path).frame_times_ns) == 3


def test_damage_in_what_is_being_recorded_is_told(whole: bytes, tmp_path: Path) -> None:
    path = tmp_path / "d.mcap"
    recorder = Recorder(path, min_free_bytes=0)
    path.write_bytes(whole[:50_000] + bytes(5000) + whole[55_000:-100])
    check = check_recording(path)
    assert check.is_being_written and check.damage.startswith("1 damaged stretch inside it")
    assert "is being written, 1 damaged" in str(check) and "recover" not in str(check)
    recorder.close()


def test_a_file_that_cannot_be_read_hides_no_other(whole: bytes, tmp_path: Path) -> None:
    good = tmp_path / "d.mcap"
    good.write_bytes(whole)
    command = ["recordings", "verify", str(tmp_path / "missing.mcap"), str(tmp_path), str(good)]
    said = CliRunner().invoke(app, command)
    missing, folder, last = said.output.replace("\n/", "\n\0/").split("\0")
    assert said.exit_code == 1
    assert "missing.mcap: cannot be read (No such file" in missing and "cannot be read (Is a dir" in folder
    assert "whole" in last
    told = json.loads(CliRunner().invoke(app, [*command, "--json"]).output)["recordings"]
    assert [bool(one["damage"]) for one in told] == [True, True, False]


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE])
@pytest.mark.parametrize("has_summary", [True, False])
def test_a_proper_file_of_another_program_is_whole(
    tmp_path: Path, compression: CompressionType, has_summary: bool
) -> None:
    path = foreign(tmp_path / "d.mcap", compression, has_summary=has_summary)
    assert str(check_recording(path)).startswith(f"{path}: whole")
    assert recover_recording(path) is None


def test_the_cut_file_of_another_program_keeps_its_channels(tmp_path: Path) -> None:
    path = foreign(tmp_path / "d.mcap", CompressionType.LZ4)
    before = messages_in(path)
    path.write_bytes(path.read_bytes()[:-100])
    recovery = recover_recording(path)
    assert recovery is not None and recovery.inside == ""
    assert messages_in(path) == before
    with path.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().library == "another"
        summary = reader.get_summary()
        assert summary is not None
        assert [summary.schemas[c.schema_id].name for c in summary.channels.values()] == ["A", "B"]


def test_channels_of_another_program_are_not_guessed(tmp_path: Path) -> None:
    path = foreign(tmp_path / "d.mcap", CompressionType.LZ4)
    damaged = bytearray(path.read_bytes())
    damaged[200] ^= 1  # in the first chunk
    path.write_bytes(damaged)
    with pytest.raises(DataError, match="what names its channels is lost; it stays as it is"):
        recover_recording(path)
    assert path.read_bytes() == damaged and list(tmp_path.iterdir()) == [path]


def test_messages_outside_of_chunks_are_not_passed_over_in_silence(whole: bytes, tmp_path: Path) -> None:
    path = tmp_path / "d.mcap"
    stream = BytesIO()
    writer = Writer(stream, use_chunking=False)
    writer.start(library=LIBRARY)
    writer.add_message(writer.register_channel("/a", "json", 0), 1, b"{}", 1)
    path.write_bytes(whole[:39] + stream.getvalue()[39:] + whole[39 : len(whole) // 2])
    recovery = recover_recording(path)
    assert recovery is not None and recovery.original is not None


def foreign(path: Path, compression: CompressionType, *, has_summary: bool = True) -> Path:
    with path.open("wb") as file:
        writer = Writer(
            file,
            chunk_size=2000,
            compression=compression,
            index_types=IndexType.ALL if has_summary else IndexType.NONE,
            repeat_channels=has_summary,
            repeat_schemas=has_summary,
            use_statistics=False,
            use_summary_offsets=has_summary,
        )
        writer.start(library="another")
        ids = [
            writer.register_channel(f"/{name.lower()}", "json", writer.register_schema(name, "jsonschema", b"{}"))
            for name in "AB"
        ]
        for n in range(200):
            writer.add_message(ids[n % 2], n, b'{"n": %d}' % n, n)
        finish(writer)
    return path


def test_a_picture_without_its_frames_record_is_left_out(tmp_path: Path) -> None:
    recorded = record(tmp_path / "whole.mcap", frames=3).path
    told = [told for told in messages_in(recorded) if told[0] in (HELLO_TOPIC, FRAME_TOPIC, IMAGE_TOPIC)]
    del told[3], told[2]  # of hello, frame 0, image 0, frame 1, image 1, …: a frame with the next one's picture
    path = tmp_path / "d.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels = register_channels(writer)
        for topic, log_ns, sensor_ns, data in told:
            writer.add_message(channels[topic], log_ns, data, sensor_ns)
        finish(writer)
    read = [(f.t_robot_ns, f.encoded) for f in frames_of(open_dataset(path))]
    assert read == [(frame(2).t_robot_ns, frame(2).jpeg)]


@pytest.mark.parametrize("window", [1, 64, 4099])
def test_chunks_are_found_across_the_border_of_what_is_read_at_once(
    whole: bytes, chunks: list[tuple[ChunkIndex, list[Told]]], monkeypatch: pytest.MonkeyPatch, window: int
) -> None:
    monkeypatch.setattr(station.recordings.chunks, "WINDOW_BYTES", window)
    found = [part for part in parts_of(BytesIO(whole[:20_000] + whole[-20_000:])) if isinstance(part, SoundChunk)]
    begins = [index.chunk_start_offset for index, _ in chunks]
    moved = len(whole) - 40_000
    assert {p.begin for p in found if p.end <= 20_000} == {
        index.chunk_start_offset for index, _ in chunks if index.chunk_start_offset + index.chunk_length <= 20_000
    }
    assert {p.begin + moved for p in found if p.begin >= 20_000} == {b for b in begins if b >= len(whole) - 20_000}


def test_what_recovery_kept_goes_with_the_recording(tmp_path: Path) -> None:
    library = NavigationLibrary(tmp_path)
    library.open()
    for name in ("nav-1", "nav-2"):
        library.store(NavigationRecord(name, "n", "ready", 1.0, "sfm"))
    path = library.recording("nav-1")
    path.write_bytes(bytes(10))
    path.with_name("recording.mcap.damaged.2").write_bytes(bytes(20))
    assert [(found.navigation_id, found.bytes) for found in finished_recordings(library)] == [("nav-1", 30)]
    remove_recording(library, "nav-1")
    assert [file.name for file in library.folder("nav-1").iterdir()] == ["record.json"]
