"""Station and robot over real sockets: data arrives, commands act, the link comes back, motors rest meanwhile."""

from __future__ import annotations

import asyncio
import socket
import time

import pytest

from robot.devices.ports import CapturedFrame, ImuReading
from shared.errors import DeviceLost, LocalProtocolError
from shared.messages import MAX_DRIVE_TTL_MS, CameraFrame, Capabilities, ErrorNotice, ImuBatch, Status
from shared.prompt_sending import UNSENT_BYTES, UNSENT_COMMAND_BYTES
from station.access.connecting import Connection
from station.robots.link import RobotLink
from station.robots.network import OwnPauses
from tests.support.link import Bench, Notes, Proxy, linked, running_robot, until


async def test_frames_imu_and_reports_arrive_as_the_devices_made_them() -> None:
    async with running_robot() as bench, linked(bench.port) as (link, notes):
        bench.imu.inject(500)
        bench.camera.put(t_robot_ns=77, size=60_000)
        await until(lambda: len(notes.sequences) == 500 and notes.frames and notes.statuses and notes.applied)
        assert notes.sequences == list(range(500))
        assert [s.t_robot_ns for b in notes.batches for s in b.samples] == [n * 4_444_444 for n in range(500)]
        frame, _ = notes.frames[0]
        assert (frame.t_robot_ns, frame.exposure_ns, len(frame.jpeg)) == (77, 5_000_000, 60_000)
        assert notes.hellos[0].capabilities == Capabilities(
            camera=True,
            imu=True,
            drive=True,
            pan_tilt=True,
            battery=True,
            hijack=True,
            max_linear_m_s=0.5,
            max_angular_rad_s=2.5,
        )
        assert notes.statuses[0].battery_v == 7.4
        state = link.state
        assert (state.imu_samples, state.imu_lost, state.frames, state.connections) == (500, 0, 1, 1)


async def test_answers_go_before_inertial_samples_and_these_before_pictures() -> None:
    order: list[str] = []

    class Ordered(Notes):
        def on_frame(self, frame: CameraFrame, t_station_ns: int) -> None:
            order.append("picture")

        def on_imu(self, batch: ImuBatch) -> None:
            order.append("samples")

        def on_notice(self, notice: ErrorNotice) -> None:
            order.append("answer")

    async with running_robot() as bench:
        link = RobotLink("127.0.0.1", bench.port, Ordered())
        task = asyncio.create_task(link.run())
        await until(lambda: link.state.connected)
        server = bench.server  # all of it is there before the connection's turn
        server._frames.put(CapturedFrame(0, 0, 640, 480, bytes(60_000)), time.monotonic_ns())
        server._backlog.append(ImuReading(0, 0, (0.0, 0.0, 0.0), (0.0, 0.0, 9.81)))
        server._broadcast(ErrorNotice(code="device", message="said"))
        server._wake_all()
        await until(lambda: len(order) == 3)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    assert order == ["answer", "samples", "picture"]


@pytest.mark.skipif(not hasattr(socket, "TCP_NOTSENT_LOWAT"), reason="Linux's")
async def test_what_waits_to_be_sent_waits_with_us_and_not_in_the_kernel() -> None:
    async with running_robot() as bench, linked(bench.port) as (link, _):
        await until(lambda: link.state.connected)
        (client,) = bench.server._clients.values()
        connection = link._connection or pytest.fail("the link says that it is connected")
        ends = [(client._writer, UNSENT_BYTES), (connection.writer, UNSENT_COMMAND_BYTES)]
        for end, unsent_bytes in ends:
            kernel = end.get_extra_info("socket")
            assert kernel.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
            assert kernel.getsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT) == unsent_bytes
            assert end.transport.get_write_buffer_limits() == (0, 1)


async def test_a_link_that_is_ended_while_the_robot_leaves_ends() -> None:
    class Leaving(Notes):
        """The connection breaks in the moment of the cancellation."""

        def on_status(self, status: Status) -> None:
            running.cancel()
            raise ConnectionResetError

    async with running_robot() as bench:
        running = asyncio.create_task(RobotLink("127.0.0.1", bench.port, Leaving()).run())
        done, _ = await asyncio.wait({running}, timeout=20)
        running.cancel()
        assert done and running.cancelled()


async def test_on_one_machine_the_computer_is_busy_and_no_network_is_bad() -> None:
    async with running_robot() as bench, linked(bench.port) as (link, _):
        await until(lambda: link.state.clock_bound_ns is not None)
        bench.camera.put(t_robot_ns=0)  # long ago
        await until(lambda: link.state.network.picture_age_ms is not None)
        assert link.state.network.sentence.startswith("this computer is too busy: ")


async def test_no_network_is_blamed_while_the_station_does_not_get_to_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Connection, "is_loopback", property(lambda _: False))
    monkeypatch.setattr("station.robots.network.GOOD_LOOP_MS", 0.0)
    async with running_robot() as bench, linked(bench.port) as (link, _):
        await until(lambda: link.state.network.grade == "slow")
        assert not link.state.network.computer_busy and link.state.network.sentence.startswith("slow network: ")
        monkeypatch.setattr(OwnPauses, "within_ns", lambda _, since_ns, now_ns: now_ns - since_ns)
        await until(lambda: link.state.network.computer_busy)
        assert link.state.network.sentence.startswith("the station's computer is ")


async def test_the_robots_clock_is_known_soon() -> None:
    async with running_robot() as bench, linked(bench.port) as (link, _):
        await until(lambda: link.state.rtt_ms is not None)
        offset_ns = link.state.clock_offset_ns
        assert offset_ns is not None and abs(offset_ns) < 500_000_000  # one machine, one monotonic clock
        assert link.to_station_ns(0) == pytest.approx(offset_ns, abs=100_000_000)


async def test_commands_reach_the_devices() -> None:
    async with running_robot() as bench, linked(bench.port) as (link, notes):
        await until(
            lambda: link.commands.drive(0.2, -0.5, 200) and (0.2, -0.5) in {h[1:] for h in bench.motors.history}
        )
        await until(lambda: any((a.linear, a.angular) == (0.2, -0.5) for a in notes.applied))
        assert link.commands.point(0.3, -0.1) and await link.commands.hijack((1.0, 2.0, 0.5)) is None
        await until(lambda: bench.head.pointed[-1:] == [(0.3, -0.1)] and bench.head.moved)
        assert bench.head.moved == [(1.0, 2.0, 0.5)]
        await until(lambda: (notes.applied[-1].pan, notes.applied[-1].tilt) == (0.3, -0.1))
        await until(lambda: bench.motors.are_off)
        await until(lambda: notes.statuses[-1].watchdog_stops == 1)


async def test_a_refused_hijack_is_answered_with_the_robots_words() -> None:
    async with running_robot() as bench, linked(bench.port) as (link, _):
        await until(lambda: link.state.connected)
        refusal = await link.commands.hijack((99.0, 0.0, 0.0))
        assert refusal is not None and refusal.code == "out_of_range" and "not free floor" in refusal.message
        assert await link.commands.hijack(None) is None  # and the next answer is its own
        assert bench.head.moved == [(3.0, 4.0, 0.0)]


async def test_a_held_joystick_keeps_the_robot_moving_and_stop_stops_it() -> None:
    async with running_robot() as bench, linked(bench.port) as (link, notes):
        await until(lambda: link.commands.drive(0.2, 0.0, 250) and len(bench.motors.history) > 10)
        link.commands.drive(0.2, 0.0, 250)
        link.commands.stop()
        await until(lambda: bench.stops_heard == 1 and bench.motors.are_off)
        count = len([h for h in bench.motors.history if h[1]])
        await until(lambda: notes.applied and notes.applied[-1].linear == 0.0)
        assert len([h for h in bench.motors.history if h[1]]) == count


async def test_a_command_beyond_the_robots_own_limits_is_refused_in_a_sentence() -> None:
    async with running_robot() as bench, linked(bench.port) as (link, notes):
        await until(lambda: link.commands.drive(1.5, 0.0, 200) and notes.notices)
        assert notes.notices[0].code == "out_of_range"
        assert "1.5 m/s" in notes.notices[0].message
        assert bench.motors.are_off and link.state.connected


async def test_a_command_that_is_no_number_never_leaves_the_station() -> None:
    async with running_robot() as bench, linked(bench.port) as (link, _):
        for linear in (float("nan"), float("inf"), 50.0):
            with pytest.raises(LocalProtocolError, match="drive command refused"):
                link.commands.drive(linear, 0.0, MAX_DRIVE_TTL_MS)
        assert link.state.connected


async def test_one_station_drives_and_any_may_stop() -> None:
    async with (
        running_robot() as bench,
        linked(bench.port, "a") as (a, notes_a),
        linked(bench.port, "b") as (b, notes_b),
    ):
        await until(lambda: a.commands.drive(0.1, 0.0, 250) and not bench.motors.are_off)
        await until(lambda: a.commands.drive(0.1, 0.0, 250) and b.commands.drive(0.3, 0.0, 250) and notes_b.notices)
        assert notes_b.notices[0].code == "not_driver"
        await until(lambda: a.commands.drive(0.1, 0.0, 250) and notes_b.statuses[-1].driver == "a")
        assert not notes_b.statuses[-1].you_drive
        b.commands.stop()
        await until(lambda: a.commands.drive(0.1, 0.0, 250) and any("let go" in n.message for n in notes_a.notices))
        await until(lambda: bench.motors.are_off)
        assert all(h[1] != 0.3 for h in bench.motors.history)


async def test_motors_stop_when_the_driver_disappears_and_stay_off_when_it_is_back() -> None:
    async with running_robot() as bench:
        proxy = Proxy(bench.port)
        await proxy.mend()
        async with linked(proxy.port) as (link, _):
            await until(lambda: link.commands.drive(0.2, 0.0, 250) and not bench.motors.are_off)
            await proxy.cut()
            await until(lambda: bench.motors.are_off)
            told = len(bench.motors.history)
            await until(lambda: not link.state.connected)
            assert not link.commands.drive(0.2, 0.0, 250) and not link.commands.stop()
            await proxy.mend()
            await until(lambda: link.state.connected)
            assert all(h[1:] == (0.0, 0.0) for h in bench.motors.history[told:])
            await until(lambda: link.commands.drive(0.2, 0.0, 250) and not bench.motors.are_off)
        await proxy.cut()


async def test_motors_stop_while_the_network_stands_still() -> None:
    async with running_robot() as bench:
        proxy = Proxy(bench.port)
        await proxy.mend()
        async with linked(proxy.port) as (link, _):
            await until(lambda: link.commands.drive(0.2, 0.0, 250) and not bench.motors.are_off)
            proxy.stall()
            for _ in range(30):  # the joystick is still held
                link.commands.drive(0.2, 0.0, 250)
                await asyncio.sleep(0.02)
            await until(lambda: bench.motors.are_off)
            proxy.flow()
            await until(lambda: link.commands.drive(0.2, 0.0, 250) and not bench.motors.are_off)
        await proxy.cut()


class PausedClock:
    """Shows this machine's time, less the pauses: as that of a station that slept."""

    def __init__(self) -> None:
        self._paused_ns = 0
        self._stands_at_ns: int | None = None

    def now_ns(self) -> int:
        return time.monotonic_ns() - self._paused_ns if self._stands_at_ns is None else self._stands_at_ns

    async def pause(self, seconds: float) -> None:
        self._stands_at_ns = stands_at_ns = self.now_ns()
        await asyncio.sleep(seconds)
        self._paused_ns, self._stands_at_ns = time.monotonic_ns() - stands_at_ns, None


async def test_a_station_whose_clock_stood_still_drives_again() -> None:
    clock = PausedClock()
    async with running_robot() as bench, linked(bench.port, now_ns=clock.now_ns) as (link, _):

        def moves() -> bool:
            link.commands.drive(0.1, 0.0, 250)
            return bool(bench.motors.history) and not bench.motors.are_off

        await until(moves)
        await clock.pause(1.0)
        await until(lambda: bench.motors.are_off)
        await until(moves)


async def test_a_robot_that_says_nothing_is_shown_as_quiet_until_it_speaks() -> None:
    async with running_robot() as bench:
        proxy = Proxy(bench.port)
        await proxy.mend()
        async with linked(proxy.port) as (link, notes):
            proxy.stall()
            await until(lambda: link.state.quiet)
            assert link.state.connected and notes.reasons == []
            proxy.flow()
            await until(lambda: not link.state.quiet)
            assert link.state.connected
        await proxy.cut()


async def test_no_imu_sample_is_lost_when_the_link_is_cut_again_and_again() -> None:
    async with running_robot() as bench:
        proxy = Proxy(bench.port)
        await proxy.mend()
        async with linked(proxy.port) as (link, notes):
            for cut in range(1, 4):
                bench.imu.inject(100)
                await until(lambda: notes.sequences)
                await proxy.cut()
                bench.imu.inject(400)
                await until(lambda: not link.state.connected)
                await proxy.mend()
                await until(lambda cut=cut: len(notes.sequences) == 500 * cut)
            assert notes.sequences == list(range(1500))
            assert (notes.gaps, link.state.imu_lost) == ([], 0)
            assert len(notes.reasons) == 3
        await proxy.cut()


async def test_what_no_longer_fits_the_backlog_is_a_counted_gap() -> None:
    async with running_robot(imu_backlog_samples=256) as bench:
        proxy = Proxy(bench.port)
        await proxy.mend()
        async with linked(proxy.port) as (link, notes):
            bench.imu.inject(10)
            await until(lambda: len(notes.sequences) == 10)
            await proxy.cut()
            bench.imu.inject(1000)
            await until(lambda: not link.state.connected)
            await proxy.mend()
            await until(lambda: notes.sequences[-1] == 1009)
            assert notes.gaps == [1000 - 256]
            assert (link.state.imu_gaps, link.state.imu_lost) == (1, 744)
            await until(lambda: notes.statuses[-1].imu_lost_in_backlog == 744)
        await proxy.cut()


async def test_the_link_finds_a_robot_that_starts_later_and_one_that_starts_anew() -> None:
    async with running_robot() as bench, linked(bench.port) as (link, notes):
        bench.imu.inject(50)
        await until(lambda: len(notes.sequences) == 50)
        await bench.stop()
        await until(lambda: not link.state.connected)
        assert "shutting down" in notes.reasons[0]
        await until(lambda: "start robot-server there" in link.state.reason)
        bench.imu.next_sequence = 0
        await bench.start()
        await until(lambda: link.state.connected)
        bench.imu.inject(50)
        await until(lambda: len(notes.sequences) == 100)
        assert notes.gaps == []  # another run counts anew
        assert notes.hellos[0].session_id != notes.hellos[1].session_id


async def test_a_command_given_while_the_connection_ends_does_not_end_the_link() -> None:
    async with running_robot() as bench, linked(bench.port) as (link, notes):
        # The goodbye closes the session; the command is due before the writing task is told.
        notes.on_notice = lambda _notice: link.commands.drive(0.2, 0.0, 250)  # type: ignore[assignment, method-assign]
        await bench.stop()
        await until(lambda: not link.state.connected)
        await bench.start()
        await until(lambda: link.state.connected)


async def test_a_stalled_station_skips_frames_keeps_imu_and_slows_nobody() -> None:
    async with running_robot() as bench:
        proxy = Proxy(bench.port)
        await proxy.mend()
        async with linked(proxy.port, "slow") as (slow, slow_notes), linked(bench.port, "quick") as (_, notes):
            proxy.stall()
            for n in range(60):
                bench.camera.put(n, size=200_000)
                bench.imu.inject(20)
                await until(lambda n=n: len(notes.frames) == n + 1)
            await until(lambda: len(notes.sequences) == 1200)
            proxy.flow()
            await until(lambda: len(slow_notes.sequences) == 1200)
            seen = len(slow_notes.frames)
            while len(slow_notes.frames) == seen:  # those made during the stall are too old now
                bench.camera.put(60, size=200_000)
                await asyncio.sleep(0.02)
            assert slow_notes.sequences == list(range(1200))
            assert slow.state.frames + slow.state.frames_skipped == slow_notes.frames[-1][0].seq + 1
            assert slow.state.frames_skipped > 10
        await proxy.cut()


async def test_a_lost_camera_is_told_and_its_return_too() -> None:
    async with running_robot() as bench, linked(bench.port) as (_, notes):
        bench.camera.frames.put_nowait(DeviceLost("the camera's cable came off"))
        await until(lambda: notes.notices)
        assert (notes.notices[0].code, notes.notices[0].message) == ("device", "camera: the camera's cable came off")
        await until(lambda: notes.statuses[-1].faults)
        bench.camera.put(5)
        await until(lambda: notes.frames and not notes.statuses[-1].faults)


async def test_shutdown_stops_motors_first_and_closes_devices() -> None:
    async with running_robot() as bench, linked(bench.port) as (link, notes):
        await until(lambda: link.commands.drive(0.2, 0.0, 250) and not bench.motors.are_off)
        await bench.stop()
        assert bench.motors.are_off
        assert bench.camera.is_closed and bench.imu.is_closed
        await until(lambda: notes.notices)
        assert notes.notices[0].code == "shutdown"


async def test_an_error_inside_robot_server_stops_the_motors_and_ends_it() -> None:
    bench = Bench()
    await bench.start()
    assert bench.task is not None
    async with linked(bench.port) as (link, notes):
        await until(lambda: link.commands.drive(0.2, 0.0, 250) and not bench.motors.are_off)
        bench.camera.frames.put_nowait(ZeroDivisionError("a bug in a device's adapter"))
        with pytest.raises(ExceptionGroup):
            await bench.task
        assert bench.motors.are_off
        assert bench.camera.is_closed
        await until(lambda: notes.reasons)


async def test_the_robots_own_clock_is_found_although_it_drifts() -> None:
    async with running_robot(clock_rate=1.0005) as bench, linked(bench.port) as (link, _):
        await until(lambda: link.state.clock_bound_ns is not None)
        now_ns = time.monotonic_ns()
        assert link.to_station_ns(bench.clock()) == pytest.approx(now_ns, abs=200_000_000)
