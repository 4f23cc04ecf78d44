"""The how-to pages are followed to the letter: packages are made from their blocks, and their examples are run."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from pages import ROOT, blocks
from reports.synthetic_sitting import make_session

import tissueid
from tissueid.cli import main
from tissueid.sessions import write_session

HOW_TO = ROOT / "docs" / "how-to"


def install(page: Path, site: Path) -> None:
    """Make the package of a page, and put it where an installer would."""
    declared, *_ = blocks(page, "toml")
    project = tomllib.loads(declared)
    (module,) = project["tool"]["hatch"]["build"]["targets"]["wheel"]["include"]
    (site / module).write_text(blocks(page, "python")[0], encoding="utf-8")
    about = site / f"{project['project']['name'].replace('-', '_')}-{project['project']['version']}.dist-info"
    about.mkdir()
    lines = [f"Metadata-Version: 2.1\nName: {project['project']['name']}\nVersion: {project['project']['version']}\n"]
    (about / "METADATA").write_text("".join(lines), encoding="utf-8")
    entries = [
        f"[{group}]\n" + "".join(f"{name} = {value}\n" for name, value in named.items())
        for group, named in project["project"]["entry-points"].items()
    ]
    (about / "entry_points.txt").write_text("\n".join(entries), encoding="utf-8")
    (about / "RECORD").write_text(f"{module},,\n{about.name}/METADATA,,\n", encoding="utf-8")


IN_THE_PROGRAM = """
import contextlib, io, json, sys
import numpy as np
from tissueid.cli import main

site, example = sys.argv[1:]
found = {}

def run(name, *arguments):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main(arguments)
    found[name] = status, out.getvalue(), err.getvalue()

run("engines", "engines", "--json", "-")
run("options", "engines", "massless", "--json", "-")
run("identify", "identify", f"{site}/session.h5", "--engine", "massless", "--option", "memory=0.05", "--json", "-")
run("refused", "identify", f"{site}/session.h5", "--engine", "massless", "--option", "memory=-1")
run("effects", "gap", "effects", "--json", "-")
run("twin", "gap", "accept", f"{site}/session.h5", "--effect", "nosuch_magnet", "--out", f"{site}/rig.toml")
exec(compile(open(example).read(), "docs/how-to/effect.md", "exec"), {})
run("by hand", "twin", "show", f"{site}/by_hand.toml")
played = "--device", f"simulated://{site}/by_hand.toml", "--site", "magnet", "--seconds", "1"
run("test", "test", *played, "--out", f"{site}/magnet.h5")

from tissueid import Record, list_engines
random, true = np.random.default_rng(3), (2000.0, 12.0)  # N/m, N s/m
force = np.repeat(random.uniform(0.0, 6.0, 1000), 4)
position = np.zeros(force.size)
for n in range(1, force.size):  # B y' + K y = u, exact for a force that is held
    pole = np.exp(-true[0] / true[1] / 2000.0)
    position[n] = pole * position[n - 1] + (1.0 - pole) * force[n] / true[0]
model = list_engines()["massless"]().fit(Record(force, position, 2000.0))
estimates = [model.report.parameters[name].value for name in ("stiffness_n_per_m", "damping_n_s_per_m")]
gap = force.copy()
gap[3000] = np.nan
found["model"] = estimates, model.memory_samples, np.flatnonzero(np.isnan(model.simulate(gap))).tolist()

from PySide6.QtWidgets import QApplication
application = QApplication([])
from tissueid.app.views.researcher.engine_form import EngineForm
form = EngineForm()
form.choose("massless")
found["form"] = form.engine.currentText(), form.about.text(), [field.label for field in form._fields.values()]

from tissueid.app.views.gap.diagnosis_result import page_content_of
from tissueid.app.views.gap.result_page import DiagnosisPage
from tissueid.device import DeviceDescription
from tissueid.gap.diagnosis import diagnose
from tissueid.gap.preparation import prepare
from tissueid.gap.workers import SerialExecutor
from tissueid.sessions import Session, Test
from tissueid.twin.catalogue import effect
from tissueid.twin.chain_parameters import InstrumentParameters, Tissue
from tissueid.twin.simulation import ActiveEffect, Start, simulate

random = np.random.default_rng(5)
command = 14.0 + 14.0 * np.convolve(random.uniform(-1, 1, 2000), np.ones(5) / 5, "same")
acting = [ActiveEffect(effect("stray_magnet"), np.array([1.0, 0.0129]))]
chain = InstrumentParameters(weight_n=0.0), Tissue(0.010), Start(14.0 / 12.0, 0.010)
read = simulate(command, 2000.0, *chain, acting).readings
noise = random.standard_normal((3, command.size))
signals = {
    "command": command,
    "voltage": read.voltage + 2e-3 * noise[0],
    "current": read.current + 1e-3 * noise[1],
    "position": read.position + 2e-6 * noise[2],
}
session = Session(DeviceDescription(), tests=(Test(1, "stochastic", signals, 2000.0, surface_position_m=0.010),))
diagnosed = diagnose(prepare(session), SerialExecutor(), candidates=["stray_magnet"])
page = DiagnosisPage()
story = page_content_of(diagnosed, session)
page.show_story(story)
found["page"] = diagnosed.combination, page.headline.text(), story.todo
json.dump(found, sys.stdout)
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What command line and window show with both packages installed, in a process of its own."""
    site = tmp_path_factory.mktemp("site")
    for name in ("engine", "effect"):
        install(HOW_TO / f"{name}.md", site)
    write_session(site / "session.h5", make_session())
    example = site / "example.txt"
    example.write_text(blocks(HOW_TO / "effect.md", "python")[1], encoding="utf-8")
    (site / "by_hand.toml").write_text(blocks(HOW_TO / "effect.md", "toml")[1], encoding="utf-8")
    path = os.pathsep.join(filter(None, [str(site), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        [sys.executable, "-W", "error::UserWarning", "-c", IN_THE_PROGRAM, str(site), str(example)],
        env=os.environ | {"PYTHONPATH": path, "QT_QPA_PLATFORM": "offscreen"},
        capture_output=True,
        text=True,
        timeout=110,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_engine_is_listed_and_fits_at_the_command_line(found: dict[str, Any]):
    assert "massless" in {item["engine"] for item in json.loads(found["engines"][1])}
    (declared,) = json.loads(found["options"][1])
    assert (declared["label"], declared["options"]["memory"]["default"]) == ("Spring and damper", 0.1)
    status, out, err = found["identify"]
    assert status == 0, err
    answer = json.loads(out)
    assert answer["options"] == {"memory": 0.05}
    assert answer["parameters"]["stiffness_n_per_m"]["value"] > 0.0
    assert 0.0 < answer["vaf_validation_percent"] < 100.0
    assert answer["messages"]["findings"][0]["code"] == "massless.time"
    status, _, err = found["refused"]
    assert (status, err.count("\n")) == (2, 1)


def test_the_engine_finds_a_known_system_and_keeps_gaps(found: dict[str, Any]):
    estimates, memory, unknown = found["model"]
    assert estimates == pytest.approx([2000.0, 12.0], rel=0.02)
    assert unknown == list(range(3000, 3000 + memory))


def test_the_engine_is_in_the_window(found: dict[str, Any]):
    assert found["form"] == ["Spring and damper", "A spring and a damper without mass.", ["Memory"]]


def test_the_effect_is_listed_and_offered_at_the_command_line(found: dict[str, Any]):
    (declared,) = [item for item in json.loads(found["effects"][1]) if item["effect"] == "stray_magnet"]
    assert declared["stage"] == "mechanics"
    assert [item["name"] for item in declared["parameters"]] == ["force_n", "place_m"]
    for name in ("by hand", "test"):
        assert found[name][0] == 0, found[name][2]
    status, _, err = found["twin"]
    assert (status, "stray_magnet" in err) == (2, True)


def test_a_diagnosis_names_the_effect_and_the_window_shows_it(found: dict[str, Any]):
    combination, headline, todo = found["page"]
    assert combination == ["stray_magnet"]
    assert "A magnet pulls the probe to one position" in headline
    assert todo[0].startswith("Remove magnets")


def test_the_lvm_file_of_the_page_is_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    (table,) = blocks(HOW_TO / "import-lvm.md", "text")
    Path("rig.lvm").write_text(table, encoding="utf-8")
    (code,) = blocks(HOW_TO / "import-lvm.md", "python")
    exec(compile(code, "docs/how-to/import-lvm.md", "exec"), {})
    test = tissueid.open_session("rig.h5").test(1)
    assert (test.sample_rate_hz, test.site) == (2000.0, "left forearm")
    assert test.signals["force"] == pytest.approx([0.10, 0.14, 0.11, 0.09])
    assert test.signals["position"] == pytest.approx([21e-6, 30e-6, 24e-6, 20e-6])
    command = blocks(HOW_TO / "import-lvm.md", "sh")[0].splitlines()[0]
    words = [quoted or plain for quoted, plain in re.findall(r'(\S*="[^"]*"|"[^"]*")|(\S+)', command)]
    arguments = [word.replace('"', "").replace("rig.h5", "again.h5") for word in words[1:]]
    assert main(arguments) == 0
    assert tissueid.open_session("again.h5").tests[0].site == "left forearm"


def test_the_device_example_lists_devices(capsys: pytest.CaptureFixture[str]):
    (code,) = blocks(HOW_TO / "device-driver.md", "python")
    exec(compile(code, "docs/how-to/device-driver.md", "exec"), {})
    assert "simulated://forearm" in capsys.readouterr().out


def test_the_translation_tool_takes_the_options_of_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A language is added as on the page, to a copy of the folder of catalogues."""
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    translations = __import__("translations")
    monkeypatch.setattr(translations, "FOLDER", tmp_path)
    monkeypatch.setattr(translations, "extracted", translations.Catalog)
    text = (HOW_TO / "translate.md").read_text(encoding="utf-8")
    lines = re.findall(r"^ +python tools/translations\.py *(.*)$", text, re.MULTILINE)
    assert lines == ["--add fr Français", "", "--check"]
    monkeypatch.setattr(sys, "argv", ["translations.py", *lines[0].split()])
    assert translations.main() == 0
    assert (tmp_path / "fr" / "LC_MESSAGES" / "tissueid.mo").is_file()
