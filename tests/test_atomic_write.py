"""Files that are whole or not there."""

from __future__ import annotations

import errno
import os
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tissueid.atomic_write import (
    atomic_file,
    atomic_folder,
    create_private,
    private_folder,
    private_opener,
    remove_leftovers,
    sync_folder,
    write_all,
    write_private,
)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("synced", [False, True])
def test_what_was_written_takes_the_place_of_what_was_there(tmp_path: Path, synced: bool):
    path = tmp_path / "answer.json"
    path.write_text("old")
    with atomic_file(path, synced=synced) as partial:
        partial.write_text("new")
        assert partial.parent == tmp_path
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert names(tmp_path) == ["answer.json"]


@pytest.mark.parametrize("error", [ValueError("a defect"), KeyboardInterrupt()])
def test_an_exception_leaves_nothing_and_the_old_file_as_it_was(tmp_path: Path, error: BaseException):
    path = tmp_path / "answer.json"
    for there in ([], ["answer.json"]):
        with pytest.raises(type(error)), atomic_file(path) as partial:
            partial.write_text("half")
            raise error
        assert names(tmp_path) == there
        path.write_text("old")
    assert path.read_text() == "old"


def test_a_full_disk_is_passed_on_and_leaves_the_old_file_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "answer.json"
    path.write_text("old")

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as caught, atomic_file(path, synced=True) as partial:
        partial.write_text("new")
    assert caught.value.errno == errno.ENOSPC
    assert path.read_text() == "old"
    assert names(tmp_path) == ["answer.json"]


@pytest.mark.skipif(sys.platform == "win32", reason="sizes of files are bounded by the system's own means elsewhere")
def test_a_write_that_the_system_cuts_short_is_passed_on(tmp_path: Path):
    path = tmp_path / "answer.json"
    path.write_text("old")
    program = (
        "import resource, signal, sys\n"
        "from pathlib import Path\n"
        "from tissueid.atomic_write import atomic_file\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\n"
        "with atomic_file(Path(sys.argv[1])) as partial:\n"
        "    partial.write_text('new' * 100_000)\n"
    )
    ended = subprocess.run([sys.executable, "-c", program, str(path)], capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert f"[Errno {errno.EFBIG}]" in ended.stderr
    assert path.read_text() == "old"
    assert names(tmp_path) == ["answer.json"]


def test_a_missing_folder_is_reported(tmp_path: Path):
    with pytest.raises(FileNotFoundError), atomic_file(tmp_path / "nowhere" / "a.json") as partial:
        partial.write_text("new")
    assert names(tmp_path) == []


def test_only_what_is_to_be_synced_is_synced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    synced: list[int] = []
    monkeypatch.setattr(os, "fsync", synced.append)
    with atomic_file(tmp_path / "a.json") as partial:
        partial.write_text("new")
    assert synced == []
    with atomic_file(tmp_path / "a.json", synced=True) as partial:
        partial.write_text("new")
    assert synced


@pytest.mark.parametrize(("number", "reported"), [(errno.EINVAL, False), (errno.EACCES, False), (errno.EIO, True)])
def test_a_failed_sync_of_the_folder_is_reported_if_the_disk_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, reported: bool
):
    def fails(_: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", fails)
    if reported:
        with pytest.raises(OSError, match=os.strerror(number)):
            sync_folder(tmp_path)
    else:
        sync_folder(tmp_path)


def test_what_cannot_be_removed_does_not_hide_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def fails(_: Path) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(Path, "unlink", fails)
    with pytest.raises(ValueError, match="a defect"), atomic_file(tmp_path / "a.json"):
        raise ValueError("a defect")


def test_a_write_that_takes_nothing_is_not_tried_for_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with (tmp_path / "a").open("wb") as file:
        monkeypatch.setattr(os, "write", lambda *_: 0)
        with pytest.raises(OSError, match="nothing more is taken"):
            write_all(file.fileno(), b"x")


# -- who may read and who may interfere ------------------------------------------------------------------------

posix = pytest.mark.skipif(sys.platform == "win32", reason="modes, locks and links of POSIX")


def mode(path: Path) -> int:
    return stat.S_IMODE(path.lstat().st_mode)


@pytest.fixture(params=[0, 0o777], ids=["open", "closed"])
def any_umask(request: pytest.FixtureRequest) -> Iterator[int]:
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


@posix
def test_files_and_folders_are_for_their_owner_alone_whatever_the_umask(tmp_path: Path, any_umask: int):
    with atomic_file(tmp_path / "a.json") as partial:
        partial.write_text("new")
        assert mode(partial) == 0o600
    with atomic_folder(tmp_path / "out") as partial:
        (partial / "a.csv").write_text("new")
        (partial / "inner").mkdir()
        assert mode(partial) == 0o700
    write_private(private_folder(tmp_path / "x" / "y") / "b", "new")
    os.close(create_private(tmp_path / "c"))
    os.close(private_opener(str(tmp_path / "d"), os.O_WRONLY | os.O_CREAT))
    files = ("a.json", "out/a.csv", "x/y/b", "c", "d")
    assert [mode(tmp_path / name) for name in files] == [0o600] * 5
    assert [mode(tmp_path / name) for name in ("out", "out/inner", "x", "x/y")] == [0o700] * 4
    with atomic_file(tmp_path / "calibration.toml", shared=True) as partial:
        partial.write_text("new")
    assert mode(tmp_path / "calibration.toml") == 0o666 & ~any_umask


@posix
@pytest.mark.usefixtures("any_umask")
def test_a_folder_of_the_user_keeps_its_mode(tmp_path: Path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine").chmod(0o755)
    private_folder(tmp_path / "mine" / "new")
    assert (mode(tmp_path / "mine"), mode(tmp_path / "mine" / "new")) == (0o755, 0o700)


@posix
def test_no_link_is_followed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Another user with write access creates a link at the name of the partial file."""
    victim = tmp_path / "victim"
    victim.write_text("precious")
    names_to_come = iter([b"\x00" * 8, b"\x11" * 8])
    monkeypatch.setattr(os, "urandom", lambda _: next(names_to_come))
    (tmp_path / f".a.json.{'00' * 8}.partial").symlink_to(victim)
    with pytest.raises(FileExistsError), atomic_file(tmp_path / "a.json"):
        raise AssertionError("nothing may be written")
    with pytest.raises(OSError, match="exchanged") as caught, atomic_file(tmp_path / "a.json") as partial:
        partial.unlink()
        partial.write_text("another's")
    assert caught.value.filename == str(tmp_path / "a.json")
    (tmp_path / "log").symlink_to(victim)
    for attempt in (lambda: create_private(tmp_path / "log"), lambda: private_opener(str(tmp_path / "log"), os.O_RDWR)):
        with pytest.raises(OSError, match=r"File exists|Too many levels"):
            attempt()
    assert victim.read_text() == "precious"
    assert not (tmp_path / "a.json").exists()


@pytest.mark.parametrize("links", [True, False])
def test_a_new_file_never_takes_the_place_of_one_that_appears_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links: bool
):
    def none(*_: object) -> None:
        raise OSError(errno.EPERM, os.strerror(errno.EPERM))

    if not links:
        monkeypatch.setattr(os, "link", none)
    path = tmp_path / "s.h5"
    with pytest.raises(FileExistsError) as caught, atomic_file(path, new=True) as partial:
        partial.write_text("mine")
        path.write_text("another's")
    assert caught.value.filename == str(path)
    assert path.read_text() == "another's"
    assert names(tmp_path) == ["s.h5"]
    path.unlink()
    with atomic_file(path, new=True, synced=True) as partial:
        partial.write_text("mine")
    assert path.read_text() == "mine"
    assert path.stat().st_nlink == 1
    assert names(tmp_path) == ["s.h5"]


@posix
def test_what_a_killed_program_left_is_removed_and_what_is_being_written_is_not(tmp_path: Path):
    path = tmp_path / "s.h5"
    left = tmp_path / f".s.h5.{'0a' * 8}.partial"
    left.write_text("half")
    others = [tmp_path / f".s2.h5.{'0a' * 8}.partial", tmp_path / ".s.h5.partial", tmp_path / ".s.h5.0a0a.partial"]
    for other in others:
        other.write_text("half")
    (tmp_path / f".s.h5.{'0b' * 8}.partial").mkdir()
    (tmp_path / f".s.h5.{'0c' * 8}.partial").symlink_to(others[0])
    with atomic_file(path) as running:
        running.write_text("mine")
        assert not left.exists()
        with atomic_file(path) as second:
            second.write_text("newer")
        remove_leftovers(path)
        assert running.read_text() == "mine"
    assert path.read_text() == "mine"
    assert names(tmp_path) == sorted(["s.h5", f".s.h5.{'0c' * 8}.partial", *(other.name for other in others)])
