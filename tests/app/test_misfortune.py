"""Misfortunes in the middle of a test: the firmware is a process at the end of a real cable, the window is real.

However it ends there is one message, the recorded part is on the disk, the coil is free as far as the device lives,
and the next test runs.
"""

import contextlib
import dataclasses
import select
import socket
import sys
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from app.benches import WAIT_MS
from app.test_window import idle, only_session, type_site, wait_for_result
from coded import made
from failing_disk import FULL, Disk
from firmware_sim_process import firmware_process
from PySide6.QtCore import Qt

from tissueid.acquisition import SessionRecorder, journal_path, recover
from tissueid.app import main_window
from tissueid.app.session_jobs import find
from tissueid.instrument import open_instrument
from tissueid.procedures import test_run
from tissueid.sessions import read_session
from tissueid.wire import Flag

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]

SPEED = ("--speed", "4")
SECONDS = 3.0
RECORDED = 4000
"""Samples of the test that are recorded when it befalls: its preload and some of its stimulus, which has 6000."""


@pytest.fixture
def device():
    """A device that outlives what befalls the window's end; a new one each time, whose coil is cold."""
    with firmware_process("--tcp=0", *SPEED) as (url, _):
        yield url


@pytest.fixture(scope="module")
def some_findings(saved):
    return find(saved)


@pytest.fixture
def mishap(monkeypatch, some_findings):
    """``now`` is called once, in the thread that records, when the next test is well under way; ``before``, before it.

    What a test says of the tissue is not what these tests are about: nothing is fitted, meanwhile or afterwards.
    """
    mishap = SimpleNamespace(now=None, before=None)

    class Recorder(SessionRecorder):
        def prepare(self, *arguments, **about):
            super().prepare(*arguments, **about)
            if mishap.before is not None:
                befall, mishap.before = mishap.before, None
                befall(self)

        def add(self, samples):
            super().add(samples)
            if mishap.now is not None and self.samples_appended >= RECORDED:
                befall, mishap.now = mishap.now, None
                befall(self)

    def find_at_once(path, session, number):
        return dataclasses.replace(some_findings, path=path, session=session, test=session.test(number))

    monkeypatch.setattr(test_run, "SessionRecorder", Recorder)
    monkeypatch.setattr(main_window, "find", find_at_once)
    monkeypatch.setattr(test_run.LiveIdentification, "step", lambda _: None)
    return mishap


@pytest.fixture
def context(open_window):
    """A window that opens what is at the other end of a cable."""
    window = open_window(opener=open_instrument)
    window.ui.form.fill({"seconds": SECONDS})
    return window


class Cable:
    """A cable of TCP to a device: it can be pulled, or go silent."""

    def __init__(self, url):
        self._device = ("127.0.0.1", int(url.rpartition(":")[2]))
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"
        self._silent, self._over = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._carry)
        self._thread.start()

    def pull(self, _=None):
        """Both ends are off at once."""
        self._over.set()
        self._thread.join()

    def fall_silent(self, _=None):
        """What is said from now on reaches nobody, and nobody is told."""
        self._silent.set()

    def _carry(self):
        with self._listener:
            while not select.select([self._listener], [], [], 0.01)[0]:
                if self._over.is_set():
                    return
            host = self._listener.accept()[0]
        with host, socket.create_connection(self._device) as device, contextlib.suppress(ConnectionError):
            to = {host: device, device: host}
            while not self._over.is_set():
                for end in select.select(list(to), [], [], 0.01)[0]:
                    data = end.recv(65536)
                    if not data:
                        return
                    if not self._silent.is_set():
                        to[end].sendall(data)


@pytest.fixture
def cable(device):
    cable = Cable(device)
    yield cable
    cable.pull()


def begin(qtbot, window, url):
    """Instrument, site and start by keyboard."""
    chooser = window.ui.form.instrument.choice
    chooser.setFocus()
    chooser.lineEdit().selectAll()
    qtbot.keyClicks(chooser, url)
    if not window.ui.form.site.currentText():
        type_site(qtbot, window)
    window.ui.form.site.setFocus()
    qtbot.keyClick(window.ui.form.site, Qt.Key.Key_S, Qt.KeyboardModifier.AltModifier)
    qtbot.waitUntil(lambda: window.testing, timeout=WAIT_MS)


def it_befalls(qtbot, window, url, mishap, what):
    """A test in whose middle that happens; returns what the window says."""
    mishap.now = what
    begin(qtbot, window, url)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert mishap.now is None, window.ui.notice.text.text()
    assert window.ui.notice.property("level") == "problem"
    return window.ui.notice.text.text()


def assert_free(url):
    """The device, asked anew, has its coil released."""
    with open_instrument(url) as instrument:
        samples = np.concatenate([instrument.poll(0.1) for _ in range(5)])
    assert samples.size
    assert not (samples["flags"] & (Flag.PLAYING | Flag.ENERGISED)).any()


def assert_the_next_test_runs(qtbot, window, url, folder):
    before = set(folder.glob("*.h5"))
    begin(qtbot, window, url)
    wait_for_result(qtbot, window)
    (path,) = set(folder.glob("*.h5")) - before
    test = read_session(path).test()
    assert (test.status, test.notes.get("reason")) == ("completed", None)
    assert not window.ui.notice.isVisible()


def assert_kept(folder, words, reason):
    """The recorded part is a session, which is named; its test says why it ended."""
    path, session = only_session(folder)
    assert words.endswith(made("outcome.saved", path=path))
    test = session.test()
    assert test.status == "aborted"
    assert reason in test.notes["reason"]
    assert RECORDED <= test.samples < 9000
    assert np.isfinite(test.signals["position"]).mean() > 0.9
    assert not journal_path(path).exists()


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_a_firmware_that_is_killed(qtbot, context, mishap, device, tmp_path):
    with firmware_process("--pty", *SPEED) as (url, process):
        words = it_befalls(qtbot, context, url, mishap, lambda _: (process.kill(), process.wait()))
    assert words.startswith(f"The connection to {url} broke")
    assert words.count("Check the cable") == 1
    assert_kept(tmp_path, words, "broke")
    assert_the_next_test_runs(qtbot, context, device, tmp_path)


@pytest.mark.parametrize(("how", "said"), [("pull", "broke"), ("fall_silent", "went silent")])
def test_a_cable_that_is_pulled_and_one_that_falls_silent(qtbot, context, mishap, device, cable, tmp_path, how, said):
    words = it_befalls(qtbot, context, cable.url, mishap, getattr(cable, how))
    assert said in words
    assert_kept(tmp_path, words, said)
    cable.pull()
    assert_free(device)
    assert_the_next_test_runs(qtbot, context, device, tmp_path)


def filled(patch):
    """Fills the disk under the journal of the test that runs, and lets it find out."""

    def fill(recorder):
        Disk(patch, journal_path(recorder.path), fails_at=1)
        recorder.journal.append(b"the next entry")
        recorder.journal.sync()

    return fill


def test_a_disk_that_fills_up(qtbot, context, mishap, device, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        words = it_befalls(qtbot, context, device, mishap, filled(patch))
    (journal,) = tmp_path.iterdir()
    assert words == f"{FULL}. {made('outcome.recording_stays', path=journal)}"
    assert_free(device)
    assert_the_next_test_runs(qtbot, context, device, tmp_path)
    test = recover(journal)[1].test()
    assert (test.status, test.samples > 0) == ("recovered", True)


def test_a_disk_that_is_full_before_the_first_sample_leaves_nothing(
    qtbot, context, mishap, device, tmp_path, monkeypatch
):
    with monkeypatch.context() as patch:
        mishap.before = filled(patch)
        words = it_befalls(qtbot, context, device, mishap, None)
    assert words == f"{FULL}. {made('outcome.nothing')}"
    assert list(tmp_path.iterdir()) == []
    assert_free(device)
