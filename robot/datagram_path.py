"""Pictures to one station by datagrams: cut and sealed, and what its reports say of them. No socket, no clock."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from robot.link_meter import LinkMeter
from robot.parity import Losses
from shared.datagrams import Opener, Sealer
from shared.errors import RemoteProtocolError
from shared.message_codec import decode_station_datagram, encode_message
from shared.messages import (
    MAX_COUNT,
    CameraFrame,
    DatagramReport,
    Datagrams,
    HeartbeatReply,
    PictureArrival,
    StationDatagram,
)
from shared.picture_pieces import MAX_PICTURE_BYTES, MESSAGE, cut, num_pieces
from shared.session import HEARTBEAT_INTERVAL_NS

SILENT_BEATS = 10  # a second of heartbeats by the connection and no word of a datagram: none arrives


@dataclass(slots=True)
class _Picture:
    """One under way."""

    number: int  # counts those of this path
    seq: int  # the camera's
    end: int  # bytes of pictures with it
    num_bytes: int
    num_pieces: int  # with parity
    t_ns: int
    met_frame: bool  # another one had not left yet
    last_datagram: int = MAX_COUNT  # until all are sent


class DatagramPath:
    """One station's way for pictures beside its connection. It is open while datagrams arrive both ways."""

    def __init__(self, told: Datagrams) -> None:
        self.meter = LinkMeter()  # counts the bytes of pictures: what protects them makes their link slower
        self.losses = Losses()
        self.newest_over = -1  # the newest picture (its `seq`) that nothing more is to come of
        self._sealer = Sealer(told.key_to_station, told.session)
        self._opener = Opener(told.key_to_robot, told.session)
        self._under_way: deque[_Picture] = deque(maxlen=64)
        self._num_pictures = self._num_bytes = 0
        self._heard = -1  # newest datagram that the station has
        self._silent_beats = SILENT_BEATS
        self._beat_ns = -HEARTBEAT_INTERVAL_NS  # when the last that counts was read

    @property
    def is_open(self) -> bool:
        return self._silent_beats < SILENT_BEATS

    def note_beat(self, read_ns: int) -> None:
        """The station's heartbeat came by the connection: a datagram could have come as well.

        What a network that carried nothing had kept comes in one burst, and is one chance for a datagram, not many.
        """
        if read_ns - self._beat_ns < HEARTBEAT_INTERVAL_NS // 2:
            return
        self._beat_ns = read_ns
        self._silent_beats = min(self._silent_beats + 1, SILENT_BEATS)

    def cut(self, frame: CameraFrame, now_ns: int) -> list[bytes] | None:
        """What a picture's datagrams hold, from now on to be sealed and sent; None: it is too large for them."""
        content = encode_message(frame)
        if len(content) > MAX_PICTURE_BYTES:
            return None
        met_frame = self.meter.is_busy(now_ns)
        contents = cut(content, self._num_pictures, self.losses.parity(num_pieces(len(content))))
        self._num_bytes += len(content)
        self.meter.send(len(content), True, now_ns)
        self._under_way.append(
            _Picture(
                self._num_pictures,
                frame.seq,
                self._num_bytes,
                len(content),
                len(contents),
                now_ns,
                met_frame,
            )
        )
        self._num_pictures += 1
        return contents

    def seal(self, content: bytes) -> bytes:
        """A datagram, to be sent at once: their numbers tell what must have come before."""
        return self._sealer.seal(content)

    def end_picture(self) -> None:
        """The last of its datagrams was sent."""
        if self._under_way:  # a report may tell of pictures that there never were
            self._under_way[-1].last_datagram = self._sealer.next_number - 1

    def reply(self, reply: HeartbeatReply) -> bytes:
        """A datagram that tells both clocks, and by its arrival that the way is open."""
        return self._sealer.seal(bytes([MESSAGE]) + encode_message(reply))

    def receive(self, datagram: bytes, now_ns: int) -> StationDatagram | None:
        """The station's report or command; None: it is not the station's, or was here before."""
        content = self._opener.open(datagram)
        if content is None:
            return None
        try:
            report = decode_station_datagram(content)
        except RemoteProtocolError:
            return None
        if not isinstance(report, DatagramReport):
            return report
        if self._heard < report.newest < self._sealer.next_number:
            self._heard = report.newest
            self._silent_beats = 0
        arrivals = {arrival.picture: arrival for arrival in report.pictures}
        while self._under_way and self._is_over(self._under_way[0], arrivals):
            picture = self._under_way.popleft()
            self._note_end(picture, arrivals.get(picture.number), report, now_ns)
        return report

    def _is_over(self, picture: _Picture, arrivals: dict[int, PictureArrival]) -> bool:
        """Something sent behind it has come, or its own last piece."""
        return self._heard >= picture.last_datagram or max(arrivals, default=-1) > picture.number

    def _note_end(self, picture: _Picture, arrival: PictureArrival | None, report: DatagramReport, now_ns: int) -> None:
        self.newest_over = picture.seq
        arrived = 0 if arrival is None else min(arrival.count, picture.num_pieces)
        self.losses.note(picture.num_pieces, picture.num_pieces - arrived)
        if arrival is None:
            self.meter.lose(picture.end)
            return
        first_ns = report.t_station_ns - arrival.first_held_ns
        last_ns = report.t_station_ns - arrival.last_held_ns
        self.meter.note_trip(picture.t_ns, first_ns, now_ns - arrival.first_held_ns, picture.met_frame)
        behind_first = max(0, arrival.last_piece - arrival.first_piece)
        spread = (picture.num_bytes * behind_first / picture.num_pieces, last_ns - first_ns) if behind_first else None
        self.meter.confirm(picture.end, arrival.last_held_ns, now_ns, last_ns, spread)
