"""Files that are whole or not there."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tissueid.whole_file import sync_folder, whole_file, write_all


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("synced", [False, True])
def test_what_was_written_takes_the_place_of_what_was_there(tmp_path: Path, synced: bool):
    path = tmp_path / "answer.json"
    path.write_text("old")
    with whole_file(path, synced=synced) as partial:
        partial.write_text("new")
        assert partial.parent == tmp_path
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert names(tmp_path) == ["answer.json"]


@pytest.mark.parametrize("error", [ValueError("a defect"), KeyboardInterrupt()])
def test_an_exception_leaves_nothing_and_the_old_file_as_it_was(tmp_path: Path, error: BaseException):
    path = tmp_path / "answer.json"
    for there in ([], ["answer.json"]):
        with pytest.raises(type(error)), whole_file(path) as partial:
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
    with pytest.raises(OSError, match="No space left") as told, whole_file(path, synced=True) as partial:
        partial.write_text("new")
    assert told.value.errno == errno.ENOSPC
    assert path.read_text() == "old"
    assert names(tmp_path) == ["answer.json"]


@pytest.mark.skipif(sys.platform == "win32", reason="sizes of files are bounded by the system's own means elsewhere")
def test_a_write_that_the_system_cuts_short_is_passed_on(tmp_path: Path):
    path = tmp_path / "answer.json"
    path.write_text("old")
    program = (
        "import resource, signal, sys\n"
        "from pathlib import Path\n"
        "from tissueid.whole_file import whole_file\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\n"
        "with whole_file(Path(sys.argv[1])) as partial:\n"
        "    partial.write_text('new' * 100_000)\n"
    )
    ended = subprocess.run([sys.executable, "-c", program, str(path)], capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert f"[Errno {errno.EFBIG}]" in ended.stderr
    assert path.read_text() == "old"
    assert names(tmp_path) == ["answer.json"]


def test_a_folder_that_is_not_there_is_told(tmp_path: Path):
    with pytest.raises(FileNotFoundError), whole_file(tmp_path / "nowhere" / "a.json") as partial:
        partial.write_text("new")
    assert names(tmp_path) == []


def test_only_what_is_to_be_synced_is_synced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    synced: list[int] = []
    monkeypatch.setattr(os, "fsync", synced.append)
    with whole_file(tmp_path / "a.json") as partial:
        partial.write_text("new")
    assert synced == []
    with whole_file(tmp_path / "a.json", synced=True) as partial:
        partial.write_text("new")
    assert synced


@pytest.mark.parametrize(("number", "told"), [(errno.EINVAL, False), (errno.EACCES, False), (errno.EIO, True)])
def test_a_folder_that_cannot_be_synced_is_told_where_that_is_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, told: bool
):
    def fails(_: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", fails)
    if told:
        with pytest.raises(OSError, match=os.strerror(number)):
            sync_folder(tmp_path)
    else:
        sync_folder(tmp_path)


def test_what_cannot_be_removed_does_not_hide_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def fails(_: Path) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(Path, "unlink", fails)
    with pytest.raises(ValueError, match="a defect"), whole_file(tmp_path / "a.json"):
        raise ValueError("a defect")


def test_a_write_that_takes_nothing_is_not_tried_for_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with (tmp_path / "a").open("wb") as file:
        monkeypatch.setattr(os, "write", lambda *_: 0)
        with pytest.raises(OSError, match="nothing more is taken"):
            write_all(file.fileno(), b"x")
