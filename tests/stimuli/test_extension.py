"""A kind of stimulus or a distribution is one file: command line and window offer it without another edit."""

import json
import os
import subprocess
import sys

PLUGIN = '''
from typing import ClassVar

import numpy as np
from pydantic import Field

from tissueid.language import marked
from tissueid.stimuli.base import OpenLoopKind, Stimulus, stimulus
from tissueid.stimuli.distributions import Distribution, distribution


@stimulus
class Sawtooth(OpenLoopKind):
    """A sawtooth of force."""

    name: ClassVar[str] = "sawtooth"
    title: ClassVar[str] = marked("Sawtooth")

    seconds: float = Field(1.0, gt=0.0, le=10.0, description=marked("Length, s"))
    sample_rate: float = Field(2000.0, gt=0.0, le=1e6, description=marked("Samples a second"))
    teeth: int = Field(4, ge=1, le=100, description=marked("Number of teeth"))

    def build(self):
        values = np.linspace(0.0, self.teeth, round(self.seconds * self.sample_rate)) % 1.0
        return Stimulus(values, self.sample_rate, self.describe(), 0, 1.7)


@distribution
class Arcsine(Distribution):
    """The distribution of a sine."""

    name: ClassVar[str] = "arcsine"

    def quantile(self, probability):
        return -np.cos(np.pi * probability)
'''

PROGRAM = """
import json
import sys

import numpy as np
from PySide6.QtWidgets import QApplication, QComboBox

from tissueid.app.stimulus_form import StimulusForm
from tissueid.cli import main
from tissueid.stimuli import build_stimulus
from tissueid.stimuli.kinds.noise import Noise

assert main(["stimulus", "sawtooth", "--option", "teeth=3", "--json", sys.argv[1]]) == 0
assert main(["stimulus", "noise", "--option", "distribution=arcsine", "--json", sys.argv[2]]) == 0
assert main(["stimulus", "noise", "--options"]) == 0
application = QApplication([])
form = StimulusForm()
form.offer_all()
kinds = {form.kind.itemData(row): form.kind.itemText(row) for row in range(form.kind.count())}
form.fill("sawtooth", {"teeth": 5})
options = dict(form.options())
form.fill("interchange", {"distribution": "arcsine"})
values = np.sort(build_stimulus("noise", {"distribution": "arcsine", "seconds": 1.0}).values)
print(json.dumps([kinds["sawtooth"], options["teeth"], dict(form.options())["distribution"], float(values[500])]))
"""


def test_one_file_adds_a_kind_and_a_distribution_everywhere(tmp_path):
    (tmp_path / "one_file.py").write_text(PLUGIN, encoding="utf-8")
    about = tmp_path / "one_file-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: one-file\nVersion: 1.0\n", encoding="utf-8")
    (about / "entry_points.txt").write_text(
        "[tissueid.stimuli]\nsawtooth = one_file:Sawtooth\n\n[tissueid.distributions]\narcsine = one_file:Arcsine\n",
        encoding="utf-8",
    )
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "QT_QPA_PLATFORM": "offscreen"}
    command = [sys.executable, "-c", PROGRAM, str(tmp_path / "a.json"), str(tmp_path / "b.json")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    title, teeth, chosen, value = json.loads(done.stdout.strip().splitlines()[-1])
    assert (title, teeth, chosen) == ("Sawtooth", 5, "arcsine")
    assert 0.0 < value < 8.0
    assert "arcsine, binary" in " ".join(done.stdout.split())
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))["description"]["teeth"] == 3
    assert json.loads((tmp_path / "b.json").read_text(encoding="utf-8"))["description"]["distribution"] == "arcsine"
