"""The link over a bad network: late, slow, half-open, cut in the middle, with wrong bytes. It comes back by itself."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from station.robots.link import RobotLink
from tests.support.fault_proxy import FaultProxy
from tests.support.link import Bench, Notes, linked, running_robot, until


@asynccontextmanager
async def over_a_bad_network(seed: int = 1) -> AsyncIterator[tuple[Bench, FaultProxy, Notes]]:
    async with running_robot() as bench:
        proxy = FaultProxy(bench.port, seed)
        await proxy.mend()
        try:
            async with linked(proxy.port) as (_, notes):
                yield bench, proxy, notes
        finally:
            await proxy.close()


def is_gapless(notes: Notes, count: int) -> bool:
    return notes.sequences == list(range(count))


async def test_what_is_late_still_comes_whole_and_in_order() -> None:
    async with over_a_bad_network() as (bench, proxy, notes):
        for faults in proxy.faults.values():
            faults.delay_s, faults.jitter_s = 0.15, 0.1
        for number in range(30):
            bench.imu.inject(10)
            bench.camera.put(number + 1)
            await asyncio.sleep(0.01)
        await until(lambda: is_gapless(notes, 300))
        assert notes.gaps == [] and notes.reasons == [] and proxy.connections == 1


async def test_a_slow_network_costs_frames_and_no_imu_sample() -> None:
    async with over_a_bad_network() as (bench, proxy, notes):
        proxy.faults["to station"].bytes_per_s = 100_000
        for number in range(100):
            bench.camera.put(number + 1, size=20_000)  # twenty times what the network takes
            bench.imu.inject(2)
            await asyncio.sleep(0.005)
        await until(lambda: is_gapless(notes, 200))
        assert notes.gaps == [] and notes.reasons == []
        assert len(notes.frames) < 100


async def test_a_half_open_connection_is_noticed_and_made_anew() -> None:
    async with over_a_bad_network() as (bench, proxy, notes):
        proxy.faults["to station"].is_swallowed = True
        await until(lambda: notes.reasons)
        proxy.heal()
        await until(lambda: len(notes.hellos) >= 2)
        bench.imu.inject(5)
        await until(lambda: notes.sequences[-5:] == list(range(bench.imu.next_sequence - 5, bench.imu.next_sequence)))


async def test_a_transport_that_is_closed_already_ends_the_connection_and_not_the_link(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A robot that was killed: uvloop's transport is closed before the reader is told, and takes no bytes then."""

    write, refused = asyncio.StreamWriter.write, []

    async with running_robot() as bench, linked(bench.port) as (_, notes):

        def refuse_once(writer: asyncio.StreamWriter, data: bytes) -> None:
            if not refused and writer.get_extra_info("peername")[1] == bench.port:
                refused.append(data)
                raise RuntimeError("unable to perform operation on <TCPTransport closed=True>; the handler is closed")
            write(writer, data)

        monkeypatch.setattr(asyncio.StreamWriter, "write", refuse_once)
        await until(lambda: len(notes.hellos) == 2)
        assert refused
        assert notes.reasons == [f"connection lost: 127.0.0.1:{bench.port} closed the connection"]


def test_what_uvloop_says_of_a_closed_transport_is_a_lost_connection() -> None:
    uvloop = pytest.importorskip("uvloop")

    async def write_too_late() -> None:
        async with running_robot() as bench:
            _, writer = await asyncio.open_connection("127.0.0.1", bench.port)
            writer.transport.abort()
            await asyncio.sleep(0.05)
            with pytest.raises(RuntimeError, match="handler is closed"):
                writer.write(b"x")
            with pytest.raises(ConnectionResetError):
                await RobotLink("127.0.0.1", bench.port, Notes())._write(writer)

    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(write_too_late())


@pytest.mark.parametrize("direction", ["to robot", "to station"])
async def test_wrong_bytes_end_a_connection_and_never_become_samples(direction: str) -> None:
    async with over_a_bad_network() as (bench, proxy, notes):
        proxy.faults[direction].garbage = 0.3  # type: ignore[index]
        for _ in range(100):
            bench.imu.inject(3)
            await asyncio.sleep(0.005)
        proxy.heal()
        await proxy.reset()
        before = len(notes.hellos)
        await until(lambda: len(notes.hellos) > before)
        bench.imu.inject(5)
        await until(lambda: notes.sequences and notes.sequences[-1] == bench.imu.next_sequence - 1)


async def test_a_robot_that_speaks_and_does_not_hear_is_met_anew() -> None:
    """As after a wrong byte in a length that it waits for: its own words go on, so that nothing is silent."""
    async with over_a_bad_network() as (bench, proxy, notes):
        proxy.faults["to robot"].is_swallowed = True

        def is_left() -> bool:
            bench.imu.inject(1)
            return bool(notes.reasons)

        await until(is_left)
        assert "does not reach the robot" in notes.reasons[0]
        proxy.heal()
        await until(lambda: len(notes.hellos) == 2)
        bench.imu.inject(5)
        await until(lambda: notes.sequences[-1:] == [bench.imu.next_sequence - 1])


async def test_cuts_in_the_middle_of_messages_never_repeat_or_reorder_samples() -> None:
    async with over_a_bad_network() as (bench, proxy, notes):
        bench.imu.inject(1)  # what is lost before the first sample cannot be known
        await until(lambda: is_gapless(notes, 1))
        for cut in range(15):
            bench.imu.inject(20)
            bench.camera.put(cut + 1, size=200_000)
            await asyncio.sleep(0.01 * (cut % 4))
            hellos = len(notes.hellos)
            await proxy.reset()
            await until(lambda hellos=hellos: len(notes.hellos) > hellos)
        bench.imu.inject(5)
        await until(lambda: notes.sequences[-1] == bench.imu.next_sequence - 1)
        assert notes.sequences == sorted(set(notes.sequences))
        missing = bench.imu.next_sequence - len(notes.sequences)
        assert sum(notes.gaps) == missing
        assert len(asyncio.all_tasks()) < 40  # of 15 connections none left anything behind


async def test_a_dead_connection_is_left_for_one_that_works() -> None:
    """Neither end is told, and the network is there: only a new connection shows it."""
    async with over_a_bad_network() as (bench, proxy, notes):
        bench.imu.inject(5)
        await until(lambda: is_gapless(notes, 5))
        proxy.abandon()
        bench.imu.inject(5)
        await until(lambda: len(notes.hellos) == 2)
        await until(lambda: is_gapless(notes, 10))
        assert "answers a new one" in notes.reasons[0] and notes.gaps == []
        assert proxy.connections == 2  # what was tried is gone on with


async def test_silence_without_a_way_around_it_costs_no_connection() -> None:
    async with over_a_bad_network() as (bench, proxy, notes):
        bench.imu.inject(5)
        await until(lambda: is_gapless(notes, 5))
        proxy.stall()  # a roam: new connections get no answer either
        before = proxy.connections
        for _ in range(40):  # all of it comes at once, before the answers to heartbeats
            bench.imu.inject(5)
            await asyncio.sleep(0.02)
        await until(lambda: proxy.connections >= before + 2)  # it looked twice
        proxy.flow()
        bench.imu.inject(5)
        await until(lambda: is_gapless(notes, 210))
        assert len(notes.hellos) == 1 and notes.reasons == []


async def test_a_station_drives_on_over_a_new_connection_where_it_says_its_own_stop_again() -> None:
    """It let go, pressed again, and hears nothing by the old connection, by which it still drives."""
    async with running_robot() as bench:
        proxy = FaultProxy(bench.port, seed=1)
        await proxy.mend()
        try:
            async with linked(proxy.port) as (link, notes):

                async def hold() -> None:
                    while True:
                        link.commands.drive(0.1, 0.0, 250)
                        await asyncio.sleep(0.02)

                holding = asyncio.create_task(hold())
                await until(lambda: bench.motors.history and not bench.motors.are_off)
                proxy.mute()
                link.commands.stop(until_confirmed=True)
                await until(lambda: len(notes.hellos) == 2 and not link.commands.awaits_stop)
                await until(lambda: bench.motors.are_off is False)
                assert bench.server.desk.refused == 0
                holding.cancel()
        finally:
            await proxy.close()
