"""What a robot learns from a station's reports: what the link carries and loses, whether datagrams arrive at all."""

from __future__ import annotations

import random

import pytest

from robot.datagram_path import SILENT_BEATS, DatagramPath
from robot.parity import Losses
from shared.datagrams import Opener, Sealer
from shared.message_codec import encode_message
from shared.messages import CameraFrame, DatagramReport, Datagrams, PictureArrival
from shared.picture_pieces import MAX_PICTURE_BYTES, Assembler, num_pieces
from shared.session import HEARTBEAT_INTERVAL_NS

MS = 1_000_000
TOLD = Datagrams(session=5, key_to_station=bytes(32), key_to_robot=bytes(range(32)))
STATION_AHEAD_NS = 7_000_000 * MS  # its clock before the robot's


def frame(seq: int, num_bytes: int = 8000) -> CameraFrame:
    return CameraFrame(seq=seq, t_robot_ns=0, exposure_ns=0, width=640, height=480, skipped=0, jpeg=bytes(num_bytes))


class Station:
    """Takes datagrams in over a link of some rate and delay, and reports after each picture. Time is simulated."""

    def __init__(self, path: DatagramPath, bytes_per_s: float, loss: float = 0.0, jitter_ms: float = 0.0) -> None:
        self.path, self.bytes_per_s, self.loss, self.jitter_ms = path, bytes_per_s, loss, jitter_ms
        self.opener = Opener(TOLD.key_to_station, TOLD.session)
        self.sealer = Sealer(TOLD.key_to_robot, TOLD.session)
        self.assembler = Assembler()
        self.random = random.Random(1)
        self.whole = 0
        self.free_ns = self.now_ns = 0

    def take_picture(self, seq: int) -> None:
        """Send one, and hear the report of it 30 ms after its end."""
        contents = self.path.cut(frame(seq), self.now_ns)
        assert contents is not None
        delay_ns = round((40 + self.jitter_ms * self.random.uniform(-1, 1)) * MS)
        self.free_ns = max(self.free_ns, self.now_ns)
        for content in contents:
            datagram = self.path.seal(content)
            self.free_ns += round(len(datagram) / self.bytes_per_s * 1e9)
            if self.random.random() >= self.loss and (opened := self.opener.open(datagram)) is not None:
                self.whole += self.assembler.add(opened, self.free_ns + delay_ns + STATION_AHEAD_NS) is not None
        self.path.end_picture()
        self.now_ns = max(self.now_ns + 66 * MS, self.free_ns + delay_ns + 30 * MS)
        self.path.receive(self.report(), self.now_ns)

    def report(self) -> bytes:
        now_ns = self.now_ns + STATION_AHEAD_NS
        pictures = tuple(
            PictureArrival(p.picture, p.count, p.first_piece, now_ns - p.first_ns, p.last_piece, now_ns - p.last_ns)
            for p in self.assembler.newest
        )
        said = DatagramReport(seq=0, t_station_ns=now_ns, newest=self.opener.newest, pictures=pictures)
        return self.sealer.seal(encode_message(said))


@pytest.mark.parametrize("bytes_per_s", [100_000, 250_000, 1_000_000])
def test_what_the_link_carries_is_known_through_jitter_and_losses(bytes_per_s: float) -> None:
    station = Station(DatagramPath(TOLD), bytes_per_s, loss=0.05, jitter_ms=30.0)
    for seq in range(100):
        station.take_picture(seq)
    estimate = station.path.meter.estimate
    parity = station.path.losses.parity(num_pieces(8000))
    assert estimate is not None
    shared = num_pieces(8000) / (num_pieces(8000) + parity)  # what parity takes is not the pictures'
    assert 0.6 * shared * bytes_per_s < estimate.bytes_per_s < 1.2 * shared * bytes_per_s
    assert station.whole >= 90


def test_losses_are_counted_whether_or_not_a_picture_survives_them() -> None:
    station = Station(DatagramPath(TOLD), 1_000_000, loss=0.2)
    for seq in range(200):
        station.take_picture(seq)
    assert station.path.losses.share == pytest.approx(0.2, abs=0.05)


def test_a_path_is_open_from_the_first_arrival_until_a_second_of_heartbeats_brings_no_other() -> None:
    station = Station(DatagramPath(TOLD), 1_000_000)
    assert not station.path.is_open
    station.path.receive(station.report(), 0)
    assert not station.path.is_open, "a report alone says that we hear the station, not that it hears us"
    station.take_picture(0)
    assert station.path.is_open
    for beat in range(SILENT_BEATS):
        assert station.path.is_open
        for _ in range(SILENT_BEATS):  # a burst of what was kept on the way is one chance for a datagram
            station.path.note_beat(beat * HEARTBEAT_INTERVAL_NS)
        station.path.receive(station.report(), station.now_ns)  # the same as before
    assert not station.path.is_open
    station.take_picture(1)
    assert station.path.is_open


def test_reports_that_are_forged_repeated_or_no_reports_change_nothing() -> None:
    station = Station(DatagramPath(TOLD), 1_000_000)
    station.path.cut(frame(0), 0)
    forged = Sealer(bytes(32), TOLD.session).seal(b"\x80")
    report = station.report()
    assert station.path.receive(forged, 0) is None
    assert station.path.receive(station.sealer.seal(b"rubbish"), 0) is None
    assert station.path.receive(report, 0) is not None and station.path.receive(report, 0) is None
    said = DatagramReport(seq=0, t_station_ns=0, newest=10**9, pictures=())  # of what was never sent
    station.path.receive(station.sealer.seal(encode_message(said)), 0)
    assert not station.path.is_open


def test_a_picture_of_which_nothing_came_is_over_when_something_behind_it_came() -> None:
    station = Station(DatagramPath(TOLD), 1_000_000)
    station.take_picture(0)
    station.loss = 1.0
    station.take_picture(1)
    assert station.path.newest_over == 0
    station.loss = 0.0
    station.take_picture(2)
    assert station.path.newest_over == 2 and station.path.meter.unconfirmed_bytes == 0


def test_a_report_of_pictures_that_never_were_ends_nothing() -> None:
    station = Station(DatagramPath(TOLD), 1_000_000)
    assert station.path.cut(frame(0), 0)
    invented = (PictureArrival(picture=7, count=1, first_piece=0, first_held_ns=0, last_piece=0, last_held_ns=0),)
    said = DatagramReport(seq=0, t_station_ns=0, newest=-1, pictures=invented)
    station.path.receive(station.sealer.seal(encode_message(said)), 0)
    station.path.end_picture()
    station.take_picture(1)
    assert station.whole == 1


def test_a_picture_that_is_too_large_is_not_cut() -> None:
    assert DatagramPath(TOLD).cut(frame(0, MAX_PICTURE_BYTES), 0) is None


def test_more_parity_is_sent_where_more_is_lost_or_lost_together() -> None:
    single, bursts, none = Losses(), Losses(), Losses()
    rng = random.Random(0)
    for number in range(400):
        single.note(10, sum(rng.random() < 0.1 for _ in range(10)))
        bursts.note(10, 5 if number % 5 == 0 else 0)
        none.note(10, 0)
    assert none.parity(8) == 1 < single.parity(8) < bursts.parity(8) <= 8 // 2 + 2
