"""Packages: one version, complete metadata, one line where a tool is missing; in the soak run, real builds."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tomllib
from importlib import util
from pathlib import Path

import pytest
from pages import ROOT

import tissueid
from tissueid.extras import EXTRAS

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
EXTRA_PACKAGES = {"sklearn": "scikit-learn", "PySide6": "PySide6-Essentials", "shiboken6": "PySide6-Essentials"}
"""Names in the package index of packages that are imported under another name."""


def tool(name: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    return importlib.import_module(name)


def test_the_version_is_in_one_place():
    assert PROJECT["project"]["dynamic"] == ["version"]
    assert PROJECT["tool"]["hatch"]["version"]["path"] == "src/tissueid/version.py"
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall(r"^version: (.+)$", citation, re.MULTILINE) == [tissueid.__version__]


def test_the_extras_install_what_the_program_misses():
    declared = PROJECT["project"]["optional-dependencies"]
    for package, extra in EXTRAS.items():
        names = {re.split(r"[>=<\[]", line)[0] for line in declared[extra]}
        assert EXTRA_PACKAGES.get(package, package) in names
    assert {"app", "study", "cluster", "docs", "test", "dev"} <= set(declared)
    base = {re.split(r"[>=<\[]", line)[0] for line in PROJECT["project"]["dependencies"]}
    assert base & {"PySide6-Essentials", "pyqtgraph", "pandas", "distributed", "sphinx"} == set()


def test_the_policies_of_the_project_are_there():
    for name in ("CITATION.cff", "CODE_OF_CONDUCT.md", "CONTRIBUTING.md", "LICENSE", "SECURITY.md"):
        assert (ROOT / name).stat().st_size > 300


def test_a_wheel_has_icon_and_desktop_entry(monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("hatchling")
    shared = tool("hatch_build", monkeypatch).shared_files(ROOT)
    assert {"share/applications/tissueid.desktop", "share/icons/hicolor/scalable/apps/tissueid.svg"} <= set(
        shared.values()
    )
    assert all(Path(path).is_file() for path in shared)
    entry = (ROOT / "packaging" / "tissueid.desktop").read_text(encoding="utf-8")
    assert {"Exec=tissueid", "Icon=tissueid"} <= set(entry.splitlines())


@pytest.mark.parametrize(("name", "package"), [("build_docs", "sphinx"), ("make_package", "hatchling")])
def test_a_missing_tool_is_named_with_its_command(
    name: str, package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    found = importlib.util.find_spec
    monkeypatch.setattr(util, "find_spec", lambda wanted: None if wanted == package else found(wanted))
    monkeypatch.setattr(sys, "argv", [name, "--out", str(tmp_path / "out")])
    assert tool(name, monkeypatch).main() == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"needs {package}, which is not installed" in line
    assert "-m pip install 'tissueid[" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["build_docs", "make_package", "make_bundle"])
def test_an_unwritable_folder_is_named(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(util, "find_spec", lambda _package: True)  # all tools are there
    occupied = tmp_path / "file"
    occupied.touch()
    monkeypatch.setattr(sys, "argv", [name, "--out", str(occupied / "out")])
    assert tool(name, monkeypatch).main() == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert str(occupied) in line


def test_dead_links_and_fetched_addresses_of_a_site_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "a.html").write_text(
        '<h1 id="top">A</h1><a href="b.html#there">b</a><a href="b.html#gone">b</a><a href="c.html">c</a>'
        '<a href="https://example.org">away</a><img src="https://example.org/x.png"><a href="#top">up</a>',
        encoding="utf-8",
    )
    (tmp_path / "b.html").write_text('<p id="there">B</p>', encoding="utf-8")
    assert sorted(tool("build_docs", monkeypatch).problems(tmp_path)) == [
        "a.html fetches https://example.org/x.png",
        "a.html: b.html#gone has no such anchor",
        "a.html: there is no c.html",
    ]


@pytest.mark.soak
def test_the_site_builds_without_warnings(tmp_path: Path):
    """Every page, equation and docstring; links and anchors are checked by the build."""
    pytest.importorskip("sphinx")
    pytest.importorskip("myst_parser")
    command = [sys.executable, ROOT / "tools" / "build_docs.py", "--out", tmp_path / "site"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "<math" in (tmp_path / "site" / "docs" / "engines" / "techniques.html").read_text(encoding="utf-8")
    assert "hammerstein" in (tmp_path / "site" / "searchindex.js").read_text(encoding="utf-8")


STARTED = """
import sys
from PySide6.QtCore import QTimer
from tissueid.app import window
show = window.MainWindow.show
def shown(self):
    show(self)
    QTimer.singleShot(500, lambda: (self.grab().save(sys.argv[1]), self.close()))
window.MainWindow.show = shown
sys.exit(window.run())
"""


def check_installed(python: list[str], folder: Path) -> None:
    """Run the demo, the commands and the window of an installed program, away from the source."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment |= {"QT_QPA_PLATFORM": "offscreen", "HOME": str(folder)}

    def run(*arguments: str) -> str:
        done = subprocess.run([*python, *arguments], cwd=folder, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    place = run("-I", "-c", "import tissueid; print(tissueid.__file__)")
    assert str(ROOT / "src") not in place
    assert run("-I", "-m", "tissueid", "--version").strip() == f"tissueid {tissueid.__version__}"
    run("-I", "-m", "tissueid", "demo", "--out", "demo")
    assert {path.name for path in (folder / "demo").iterdir()} >= {"report.html", "session.h5"}
    run("-I", "-m", "tissueid", "gap", "effects")
    run("-I", "-c", STARTED, str(folder / "window.png"))
    assert (folder / "window.png").stat().st_size > 10_000
    languages = run("-I", "-c", "from tissueid.language import languages; print(sorted(languages()))")
    assert languages.strip() == "['de', 'en']"
    package = Path(place.strip()).parent
    assert (package / "app" / "help" / "de" / "start.md").is_file()


@pytest.mark.soak
def test_the_wheel_runs_in_an_environment_of_its_own(tmp_path: Path):
    """The dependencies are those of this environment; the program comes from the wheel only."""
    pytest.importorskip("hatchling")
    command = [sys.executable, ROOT / "tools" / "make_package.py", "--out", tmp_path / "dist"]
    subprocess.run(command, check=True, capture_output=True)
    names = {path.name for path in (tmp_path / "dist").iterdir()}
    version = tissueid.__version__
    assert names == {f"tissueid-{version}-py3-none-any.whl", f"tissueid-{version}.tar.gz"}
    venv = tmp_path / "venv"
    subprocess.run([sys.executable, "-m", "venv", str(venv)], check=True)
    python = str(venv / "bin" / "python")
    wheel = next((tmp_path / "dist").glob("*.whl"))
    options = ["--no-deps", "--no-index", "--disable-pip-version-check", "--quiet"]
    subprocess.run([python, "-m", "pip", "install", *options, str(wheel)], check=True)
    (site,) = (venv / "lib").glob("python*/site-packages")
    (site / "dependencies.pth").write_text(str(Path(pytest.__file__).parents[1]) + "\n", encoding="utf-8")
    assert (venv / "share" / "man" / "man1" / "tissueid.1").is_file()
    check_installed([python], tmp_path)


@pytest.mark.soak
@pytest.mark.skipif(sys.platform == "win32", reason="the launcher is a shell script")
def test_the_bundle_runs_where_it_is_moved_to(tmp_path: Path):
    pytest.importorskip("hatchling")
    command = [sys.executable, ROOT / "tools" / "make_bundle.py", "--folder", "--out", tmp_path / "dist"]
    subprocess.run(command, check=True, capture_output=True)
    (made,) = (tmp_path / "dist").iterdir()
    bundle = tmp_path / "moved here"
    shutil.move(made, bundle)
    done = subprocess.run([bundle / "bin" / "tissueid", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"tissueid {tissueid.__version__}"
    check_installed([str(bundle / "python" / "bin" / "python3")], tmp_path)
    home = tmp_path / "home"
    home.mkdir()
    environment = {"HOME": str(home), "PATH": os.environ["PATH"]}
    subprocess.run([bundle / "install.sh"], env=environment, check=True, capture_output=True)
    entry = (home / ".local/share/applications/tissueid.desktop").read_text(encoding="utf-8")
    assert f'Exec="{bundle}/bin/tissueid"' in entry
    subprocess.run([bundle / "install.sh", "--remove"], env=environment, check=True, capture_output=True)
    assert not (home / ".local/share/applications/tissueid.desktop").exists()
