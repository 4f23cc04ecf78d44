"""Starting the application, and saying in one line why it cannot be started."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from firmware_sim_process import firmware_process

from tissueid.audit import last_lines
from tissueid.cli.window import SYSTEM_PACKAGES, check_display
from tissueid.errors import UnusableInputError
from tissueid.sessions import read_session

ROOT = Path(__file__).parents[2]


def start(code, **environment):
    clean = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    return subprocess.run(
        [sys.executable, "-c", f"import sys\n{code}\nfrom tissueid.cli import main\nsys.exit(main([]))"],
        capture_output=True,
        text=True,
        env=clean | environment,
        timeout=60,
        check=False,
    )


def one_line(answer):
    assert answer.returncode == 2
    assert answer.stderr.count("\n") == 1
    return answer.stderr


@pytest.mark.parametrize("missing", ["PySide6", pytest.param("pyqtgraph", marks=pytest.mark.soak)])
def test_without_qt_it_says_what_to_install(missing):
    line = one_line(start(f"sys.modules['{missing}'] = None", QT_QPA_PLATFORM="offscreen"))
    assert "make env" in line
    assert missing in line


def test_without_a_system_library_it_names_the_packages():
    code = """
import importlib.abc
class Broken(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == "tissueid.app.window":
            raise ImportError("libEGL.so.1: cannot open shared object file: No such file or directory")
sys.meta_path.insert(0, Broken())
"""
    line = one_line(start(code, QT_QPA_PLATFORM="offscreen"))
    assert "libEGL.so.1" in line
    assert SYSTEM_PACKAGES in line


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="there is always a display")
def test_without_a_display_it_says_so():
    assert "there is no display" in one_line(start("", QT_QPA_PLATFORM=""))


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="there is always a display")
def test_a_dead_display_is_said_and_does_not_abort():
    line = one_line(start("", QT_QPA_PLATFORM="", DISPLAY=":4711"))
    assert ":4711 does not answer" in line or "system library" in line


@pytest.mark.parametrize(
    ("environment", "platform"),
    [
        ({}, "win32"),
        ({}, "darwin"),
        ({"QT_QPA_PLATFORM": "offscreen"}, "linux"),
        ({"QT_QPA_PLATFORM": "vnc:size=800x600"}, "linux"),
        ({"WAYLAND_DISPLAY": "wayland-0"}, "linux"),
    ],
)
def test_displays_that_are_left_to_qt(environment, platform):
    check_display(environment, platform)


def test_xcb_without_a_display_is_refused():
    with pytest.raises(UnusableInputError, match="no display"):
        check_display({"QT_QPA_PLATFORM": "xcb", "WAYLAND_DISPLAY": "wayland-0"}, "linux")


def test_the_script_installs_what_the_message_names():
    script = (ROOT / "tools" / "check_qt_libraries.sh").read_text(encoding="utf-8")
    (packages,) = re.findall(r'^packages="([^"$]*)"', script, re.MULTILINE)
    assert packages.split() == SYSTEM_PACKAGES.split()


@pytest.mark.parametrize("how", ["close", pytest.param("SIGINT", marks=pytest.mark.soak), "SIGTERM"])
def test_the_application_ends_cleanly(tmp_path, how):
    ending = "window.close()" if how == "close" else f"os.kill(os.getpid(), signal.{how})"
    code = f"""
import os, signal, sys
from PySide6.QtCore import QTimer
from tissueid.app.main_window import MainWindow
shown = MainWindow.show
def show(window):
    shown(window)
    # Two thirds of the time to the first picture went into these; they come when they are wanted, or soon after.
    assert not {{"scipy.signal", "scipy.stats", "scipy.linalg", "numba", "matplotlib", "pint"}} & set(sys.modules)
    QTimer.singleShot(0, lambda: {ending})
MainWindow.show = show
"""
    answer = start(code, QT_QPA_PLATFORM="offscreen", HOME=str(tmp_path), XDG_DOCUMENTS_DIR=str(tmp_path))
    assert (answer.returncode, answer.stdout) == (0, "")
    assert "Traceback" not in answer.stderr


@pytest.fixture
def display():
    """A display of X without a screen, where the program for it is installed."""
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is not installed (package xvfb): no real window can be opened here")
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", "1280x800x24"], pass_fds=(write,), stderr=subprocess.DEVNULL
    )
    os.close(write)
    try:
        with os.fdopen(read) as pipe:
            yield f":{pipe.readline().strip()}"
    finally:
        server.terminate()
        server.wait()


def in_a_real_window(display, *command, **environment):
    clean = {name: value for name, value in os.environ.items() if name != "WAYLAND_DISPLAY"}
    return subprocess.run(
        [sys.executable, *command],
        cwd=ROOT,
        env=clean | {"DISPLAY": display, "QT_QPA_PLATFORM": "xcb"} | environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.soak
def test_a_clinician_measures_in_a_real_window(display, tmp_path):
    """The program as it is started, a device at a real cable, keys and clicks; what is left is a session."""
    places = {f"XDG_{name}_HOME": str(tmp_path / name) for name in ("CONFIG", "DATA", "STATE", "CACHE")}
    places |= {"HOME": str(tmp_path), "XDG_DOCUMENTS_DIR": str(tmp_path), "TISSUEID_AUDIT": str(tmp_path / "audit")}
    with firmware_process("--tcp=0", "--speed", "4") as (url, _):
        answer = in_a_real_window(display, "tests/app/real_window.py", url, LC_ALL="C", **places)
    assert (answer.returncode, answer.stdout) == (0, "")
    assert "Traceback" not in answer.stderr
    (path,) = tmp_path.rglob("*.h5")
    session = read_session(path)
    test = session.test()
    assert (test.status, test.site, test.samples) == ("completed", "left calf", 3000)
    assert session.subject.pseudonym == "P-042"
    assert not list(tmp_path.rglob("*.journal"))
    said = [line.what for line in last_lines(tmp_path / "audit", 20)]
    assert {"session.begun", "test.begun", "test.completed", "session.written"} <= set(said)


@pytest.mark.soak
def test_the_whole_path_in_a_real_window(display):
    answer = in_a_real_window(display, "-m", "pytest", "tests/app/test_window.py", "-k", "whole_path", "-n", "0")
    assert answer.returncode == 0, answer.stdout
    assert "2 passed" in answer.stdout
