"""Files that are refused before anything parses them, and files that another program holds."""

import errno
import os
import socket
from pathlib import Path

import h5py
import pytest

from tests.coded import coded
from tests.sessions.hostile import a_session
from tissueid.errors import SessionFormatError
from tissueid.messages import code_of
from tissueid.sessions import hdf5_members, read_outline, read_own_session
from tissueid.sessions.file_policy import session_files
from tissueid.untrusted_input import MAX_FILE_BYTES


@pytest.fixture
def path(tmp_path):
    return a_session(tmp_path / "s.h5", samples=20)


@pytest.fixture
def sparse(tmp_path):
    """A function that makes a file of a size, of which only its signature is stored."""

    def make(size: int) -> Path:
        path = tmp_path / "sparse.h5"
        with h5py.File(path, "w") as file:
            file["a"] = 1.0
        os.truncate(path, size)
        return path

    return make


@pytest.mark.parametrize(
    ("size", "code"),
    [(20_000_000_000, "file.too_large"), (MAX_FILE_BYTES, "file.sparse"), (200_000_000, "file.sparse")],
)
def test_a_sparse_file_is_refused_before_it_is_parsed(sparse, size, code, monkeypatch):
    path = sparse(size)
    if not path.stat().st_blocks:
        pytest.skip("this file system does not count blocks")
    for read in (read_outline, read_own_session):
        with monkeypatch.context() as patch, pytest.raises(SessionFormatError, check=coded(code, path=str(path))):
            patch.setattr(hdf5_members, "check_heaps", pytest.fail)
            read(path)


def test_a_folder_gives_regular_files_with_their_signature(tmp_path):
    with h5py.File(tmp_path / "source", "w") as file:
        file["a"] = 1.0
    content = (tmp_path / "source").read_bytes()
    (tmp_path / "good.h5").write_bytes(content)
    (tmp_path / "block.h5").write_bytes(b"\0" * 512 + content)  # HDF5 with a user block
    (tmp_path / "link.H5").symlink_to(tmp_path / "good.h5")
    (tmp_path / "text.h5").write_bytes(b"not HDF5" * 999)
    (tmp_path / "empty.h5").write_bytes(b"")
    (tmp_path / "lost.h5").symlink_to(tmp_path / "none")
    (tmp_path / "zeros.h5").symlink_to("/dev/zero")
    (tmp_path / "folder.h5").mkdir()
    (tmp_path / "folder.h5" / "inside.h5").write_bytes(content)
    os.mkfifo(tmp_path / "pipe.h5")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "socket.h5"))
    found = {path.name: code_of(reason) for path, reason in session_files(tmp_path).items()}
    assert found == {
        "block.h5": "",
        "empty.h5": "session.damaged",
        "good.h5": "",
        "link.H5": "",
        "lost.h5": "file.missing",
        "pipe.h5": "file.not_plain",
        "socket.h5": "file.not_plain",
        "text.h5": "session.damaged",
        "zeros.h5": "file.not_plain",
    }
    assert [path.name for path, reason in session_files(tmp_path, recursive=True).items() if reason is None] == [
        "block.h5",
        "inside.h5",
        "good.h5",
        "link.H5",
    ]


def test_a_record_of_another_program_is_named_as_such(tmp_path):
    (tmp_path / "record.csv").write_text("time (s),force (N)\n0,1\n")
    with pytest.raises(SessionFormatError, check=coded("session.record", path=str(tmp_path / "record.csv"))):
        read_outline(tmp_path / "record.csv")


def test_a_file_that_another_program_holds_is_not_damaged(path):
    held = coded("session.open_elsewhere", path=str(path))
    with h5py.File(path, "r+"), pytest.raises(SessionFormatError, check=held):
        read_outline(path)
    assert read_outline(path).tests


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOSYS])
def test_a_drive_without_locks_is_read_without_them(path, number, monkeypatch):
    real = h5py.File

    def without_locks(name, mode, locking=None):
        if locking is not False:
            raise OSError(number, "unable to lock file")
        return real(name, mode, locking=locking)

    monkeypatch.setattr(h5py, "File", without_locks)
    assert read_own_session(path).tests


def test_a_drive_that_fails_is_not_a_damaged_file(path, monkeypatch):
    def failing(*_, **__):
        raise OSError(errno.EIO, "read failed")

    monkeypatch.setattr(h5py, "File", failing)
    with pytest.raises(SessionFormatError, check=coded("file.unreadable", path=str(path))):
        read_own_session(path)


def test_a_file_whose_writer_was_ended_says_so(tmp_path):
    path = tmp_path / "left.h5"
    with h5py.File(path, "w", libver="latest") as file:
        file["a"] = 1.0
        file.flush()
        left = path.read_bytes()
    path.write_bytes(left)
    with pytest.raises(SessionFormatError, check=coded("session.left_open", path=str(path))):
        read_own_session(path)
