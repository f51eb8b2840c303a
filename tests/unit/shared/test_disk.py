"""Files are there whole or not at all, whoever is killed or fails in the middle; locks end with their holder."""

from __future__ import annotations

import fcntl
import os
import stat
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from shared.disk import (
    PRIVATE,
    SCRATCH,
    lock,
    make_folder,
    remove_scratch,
    replace_file,
    replacing,
    replacing_folder,
    settle_folder,
    settle_folders,
    unlock,
)

OLD, NEW = b"old" * 1000, b"new" * 2000


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("scratch", [None, ".scratch"])
def test_a_file_is_replaced_and_nothing_else_is_left(tmp_path: Path, scratch: str | None) -> None:
    path = tmp_path / "x"
    for content in (OLD, NEW):
        with replacing(path, scratch=None if scratch is None else tmp_path / scratch) as file:
            file.write(content)
            assert not path.exists() or path.read_bytes() == OLD
        assert path.read_bytes() == content
    assert names(tmp_path) == ["x"]


def test_it_is_on_the_disk_before_its_name_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[bool, bytes]] = []
    path = tmp_path / "x"
    path.write_bytes(OLD)
    monkeypatch.setattr(os, "fsync", lambda fd: seen.append((stat.S_ISDIR(os.fstat(fd).st_mode), path.read_bytes())))
    replace_file(path, NEW)
    assert seen == [(False, OLD), (True, NEW)]


def test_a_writer_that_fails_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    replace_file(tmp_path / "x", OLD)
    with pytest.raises(ZeroDivisionError), replacing(tmp_path / "x") as file:
        file.write(bytes(file.write(NEW) // 0))
    assert names(tmp_path) == ["x"] and (tmp_path / "x").read_bytes() == OLD


def test_a_disk_that_fails_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace_file(tmp_path / "x", OLD)

    def fail(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="No space left"):
        replace_file(tmp_path / "x", NEW)
    assert names(tmp_path) == ["x"] and (tmp_path / "x").read_bytes() == OLD


@pytest.mark.parametrize("scratch", ["None", "path.with_name('.scratch')"])
def test_a_writer_that_is_killed_leaves_the_old_file(tmp_path: Path, scratch: str) -> None:
    replace_file(tmp_path / "x", OLD)
    script = (
        "import os, sys; from pathlib import Path; from shared.disk import replacing; path = Path(sys.argv[1])\n"
        f"with replacing(path, scratch={scratch}) as file: file.write(b'half'); file.flush(); os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", script, tmp_path / "x"], check=False).returncode == -9
    assert (tmp_path / "x").read_bytes() == OLD
    left = ".scratch" if "scratch" in scratch else SCRATCH
    assert [name.startswith(left) for name in names(tmp_path)] == [True, False]
    with replacing(tmp_path / "x", scratch=tmp_path / ".scratch") as file:
        file.write(NEW)
    assert (tmp_path / "x").read_bytes() == NEW and not (tmp_path / ".scratch").exists()


def killed(script: str, *arguments: Path) -> None:
    """Run it until it kills itself."""
    head = "import os, sys; from pathlib import Path; from shared.disk import *; path = Path(sys.argv[1])\n"
    assert subprocess.run([sys.executable, "-c", head + script, *arguments], check=False).returncode == -9


def test_what_a_killed_writer_left_is_removed_and_what_is_being_written_stays(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    killed("with replacing(path) as file: file.write(b'half'); os.kill(os.getpid(), 9)", tmp_path / "deep" / "x")
    foreign = tmp_path / f"{SCRATCH}of-a-person"
    foreign.touch()
    with replacing(tmp_path / "y") as file:
        file.write(NEW)
        remove_scratch(tmp_path)
        assert len(names(tmp_path)) == 3 and not names(tmp_path / "deep")
    assert (tmp_path / "y").read_bytes() == NEW and names(tmp_path) == [foreign.name, "deep", "y"]


def look_before_the_first_lock(look: Callable[[Path], None], folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a program does that starts after another has made its file or folder, and before that is locked."""
    lock_really, looks = fcntl.flock, iter([True])

    def lock_late(descriptor: int, kind: int) -> None:
        if next(looks, False):
            with monkeypatch.context() as others:
                others.setattr(fcntl, "flock", lock_really)
                look(folder)
        lock_really(descriptor, kind)

    monkeypatch.setattr(fcntl, "flock", lock_late)


def test_a_writer_whose_file_is_taken_for_a_killed_ones_makes_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    look_before_the_first_lock(remove_scratch, tmp_path, monkeypatch)
    replace_file(tmp_path / "x", NEW)
    assert (tmp_path / "x").read_bytes() == NEW and names(tmp_path) == ["x"]


def test_of_several_writers_at_once_one_has_the_whole_file(tmp_path: Path) -> None:
    contents = [bytes([number]) * 100_000 for number in range(8)]
    writers = [threading.Thread(target=replace_file, args=(tmp_path / "x", content)) for content in contents]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert (tmp_path / "x").read_bytes() in contents and names(tmp_path) == ["x"]


def test_a_private_file_is_private_from_its_first_byte(tmp_path: Path) -> None:
    with replacing(tmp_path / "x", mode=PRIVATE) as file:
        assert stat.S_IMODE(os.fstat(file.fileno()).st_mode) == PRIVATE
    assert stat.S_IMODE((tmp_path / "x").stat().st_mode) == PRIVATE


def test_folders_are_made_with_their_parents_and_their_names_flushed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flushed: list[Path] = []
    monkeypatch.setattr(os, "fsync", lambda fd: flushed.append(Path(os.readlink(f"/proc/self/fd/{fd}"))))
    for _ in range(2):
        make_folder(tmp_path / "a" / "b")
        assert flushed == [tmp_path, tmp_path / "a"]
    (tmp_path / "file").touch()
    with pytest.raises(FileExistsError):
        make_folder(tmp_path / "file")


def test_a_folder_is_replaced_whole_with_all_that_is_in_it_flushed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flushed: list[int] = []
    monkeypatch.setattr(os, "fsync", lambda fd: flushed.append(os.fstat(fd).st_ino))
    folder = tmp_path / "f"
    for number in range(2):
        with replacing_folder(folder) as fresh:
            (fresh / "deep").mkdir()
            (fresh / "deep" / str(number)).write_bytes(NEW)
        inside = [tmp_path, folder, *folder.rglob("*")]
        assert {path.stat().st_ino for path in inside} <= set(flushed) and names(tmp_path) == ["f"]
        assert names(folder / "deep") == [str(number)]


def test_a_folder_that_could_not_be_filled_leaves_the_old_one(tmp_path: Path) -> None:
    with replacing_folder(tmp_path / "f") as fresh:
        (fresh / "old").touch()
    with pytest.raises(ZeroDivisionError), replacing_folder(tmp_path / "f") as fresh:
        (fresh / "new").write_bytes(bytes((fresh / "half").write_bytes(NEW) // 0))
    assert names(tmp_path) == ["f"] and names(tmp_path / "f") == ["old"]


@pytest.mark.parametrize("when", ["with replacing_folder(path) as fresh: die()", "rename"])
def test_a_folder_whose_writer_is_killed_is_the_old_one_again(tmp_path: Path, when: str) -> None:
    folder = tmp_path / "f"
    with replacing_folder(folder) as fresh:
        (fresh / "old").touch()
    if when == "rename":  # between the two names
        when = (
            "rename = Path.rename\n"
            "Path.rename = lambda *names: (rename(*names), die())\n"
            "with replacing_folder(path) as fresh: (fresh / 'new').touch()"
        )
    killed(f"die = lambda: os.kill(os.getpid(), 9)\n{when}", folder)
    assert len(list(tmp_path.glob(".new-*"))) == 1
    settle_folders(tmp_path, "f")
    assert names(tmp_path) == ["f"] and names(folder) == ["old"]


def test_a_writer_whose_folder_is_taken_for_a_killed_ones_makes_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    look_before_the_first_lock(lambda parent: settle_folders(parent, "f"), tmp_path, monkeypatch)
    with replacing_folder(tmp_path / "f") as fresh:
        (fresh / "new").touch()
    assert names(tmp_path) == ["f"] and names(tmp_path / "f") == ["new"]


def test_a_folder_whose_writer_is_interrupted_between_the_names_is_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with replacing_folder(tmp_path / "f") as fresh:
        (fresh / "old").touch()
    rename_really, interrupts = Path.rename, iter([KeyboardInterrupt()])

    def rename(path: Path, target: Path) -> Path:
        moved = rename_really(path, target)
        for interrupt in interrupts:
            raise interrupt
        return moved

    monkeypatch.setattr(Path, "rename", rename)
    with pytest.raises(KeyboardInterrupt), replacing_folder(tmp_path / "f") as fresh:
        (fresh / "new").touch()
    assert names(tmp_path) == ["f"] and names(tmp_path / "f") == ["old"]


def test_an_old_folder_that_cannot_be_given_its_name_back_now_is_at_the_next_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with replacing_folder(tmp_path / "f") as fresh:
        (fresh / "old").touch()
    rename_really, works = Path.rename, iter([True])

    def rename(path: Path, target: Path) -> Path:
        if next(works, False):
            return rename_really(path, target)
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as broken:
        broken.setattr(Path, "rename", rename)
        with pytest.raises(OSError, match="Input/output"), replacing_folder(tmp_path / "f") as fresh:
            (fresh / "new").touch()
    assert not (tmp_path / "f").exists()
    settle_folders(tmp_path, "f")
    assert names(tmp_path) == ["f"] and names(tmp_path / "f") == ["old"]


def test_the_old_folder_that_an_older_program_left_nameless_is_given_back_its_name(tmp_path: Path) -> None:
    for part in ("old", "fresh"):
        (tmp_path / ".new-x" / part).mkdir(parents=True)
        (tmp_path / ".new-x" / part / part).touch()
    settle_folders(tmp_path, "f")
    assert names(tmp_path) == ["f"] and names(tmp_path / "f") == ["old"]
    (tmp_path / ".new-y" / "old").mkdir(parents=True)
    settle_folders(tmp_path, "f")  # a new one has its name
    assert names(tmp_path) == ["f"] and names(tmp_path / "f") == ["old"]


def test_where_others_have_folders_only_the_one_that_is_asked_for_is_given_back(tmp_path: Path) -> None:
    others = [tmp_path / name for name in (".new-ideas/before/g", ".new-house/old")]
    for folder in (*others, tmp_path / ".new-x/before/f"):
        folder.mkdir(parents=True)
    settle_folder(tmp_path / "f")
    settle_folder(tmp_path / "f*")
    assert names(tmp_path) == [".new-house", ".new-ideas", "f"] and all(folder.is_dir() for folder in others)


def test_who_replaces_a_folder_again_finds_what_a_killed_program_took_from_it(tmp_path: Path) -> None:
    (tmp_path / ".new-x/before/f/note").mkdir(parents=True)
    with replacing_folder(tmp_path / "f") as fresh:
        assert names(tmp_path / "f") == ["note"]
        (fresh / "new").touch()
    assert names(tmp_path) == ["f"] and names(tmp_path / "f") == ["new"]


def test_a_folder_that_is_being_filled_is_left_alone(tmp_path: Path) -> None:
    with replacing_folder(tmp_path / "f") as fresh:
        settle_folders(tmp_path, "f")
        (fresh / "new").touch()
    assert names(tmp_path / "f") == ["new"]


HOLD = (
    "import sys; from shared.disk import lock; file = open(sys.argv[1], 'ab'); print(lock(file), flush=True); input()"
)


def test_a_lock_ends_when_its_holder_is_killed(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLD, tmp_path / "x"]
    holder = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert holder.stdout is not None and holder.stdout.readline() == "True\n"
    with (tmp_path / "x").open("ab") as file:
        assert (
            not lock(file, timeout_s=0) and not lock(file, timeout_s=0.1) and not lock(file, shared=True, timeout_s=0)
        )
        holder.kill()
        assert lock(file)  # waits as long as it takes, which is until the kernel has buried the holder
    holder.communicate()


def test_a_shared_lock_is_shared_and_keeps_others_out(tmp_path: Path) -> None:
    with (tmp_path / "x").open("ab") as a, (tmp_path / "x").open("ab") as b, (tmp_path / "x").open("ab") as c:
        assert lock(a, shared=True, timeout_s=0) and lock(b, shared=True, timeout_s=0)
        assert not lock(c, timeout_s=0)
        unlock(a)
        b.close()
        assert lock(c, timeout_s=0)
