"""An engine of another package is found by its entry point, and runs with the built-in ones.

The package is a real one, as an installer leaves it: a module, and next to it the metadata with an entry point. It
is put on the path of a process of its own, so that nothing of it stays in this one.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from reports.synthetic_sitting import make_session

from tissueid.sessions import write_session

MODULE = '''
"""A description by one number."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydantic import Field

from tissueid.identification import Engine, Family, FitReport, Model, aic, aicc, engine, vaf_percent
from tissueid.identification.preparation import prepare


@dataclass(frozen=True, eq=False)
class SpringModel(Model):
    slope: float
    offset: float

    def simulate(self, u):
        return self.offset + self.slope * np.asarray(u, dtype=np.float64)


@engine
class Spring(Engine):
    """A spring without mass or damping."""

    name: ClassVar[str] = "spring"
    family: ClassVar[Family] = Family.LINEAR

    ridge: float = Field(0.0, ge=0.0, le=1.0, description="Share of the input's power added to it")

    def fit(self, record, fit_part=None):
        prepared = prepare(record, fit_part, 1.0 / record.sample_rate_hz, 2)
        used = prepared.used
        u, y = record.input[used] - prepared.input_mean, record.output[used]
        slope = float(u @ y / (u @ u * (1.0 + self.ridge)))
        offset = float(np.mean(y)) - slope * prepared.input_mean
        residual = y - offset - slope * record.input[used]
        report = FitReport(
            engine=self.name,
            options=self.options(),
            n_samples=int(used.sum()),
            n_parameters=2,
            vaf_percent=vaf_percent(y, y - residual),
            aic=aic(residual, 2),
            aicc=aicc(residual, 2),
            warnings=prepared.warnings,
            findings=("a spring is all that was looked for",),
        )
        return SpringModel(report, record.sample_rate_hz, 1, slope, offset)
'''

METADATA = """Metadata-Version: 2.1
Name: other-tissue
Version: 1.2.3
Requires-Dist: tissueid
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of installed packages with one in it, and a broken one; and a session."""
    folder = tmp_path_factory.mktemp("site")
    for name, module, entry in (
        ("other_tissue", MODULE, "spring = other_tissue:Spring"),
        ("broken_tissue", "raise ImportError('half installed')\n", "broken = broken_tissue:Engine"),
    ):
        (folder / f"{name}.py").write_text(module, encoding="utf-8")
        about = folder / f"{name}-1.2.3.dist-info"
        about.mkdir()
        (about / "METADATA").write_text(METADATA.replace("other-tissue", name), encoding="utf-8")
        (about / "entry_points.txt").write_text(f"[tissueid.engines]\n{entry}\n", encoding="utf-8")
        (about / "RECORD").write_text(f"{name}.py,,\n{about.name}/METADATA,,\n", encoding="utf-8")
    write_session(folder / "session.h5", make_session())
    return folder


COMMANDS = """
import contextlib, io, json, sys
from tissueid.cli import main
ended = {}
for name, arguments in json.load(sys.stdin).items():
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main(arguments)
    ended[name] = status, out.getvalue(), err.getvalue()
json.dump(ended, sys.stdout)
"""


@pytest.fixture(scope="module")
def ended(site: Path) -> dict[str, tuple[int, str, str]]:
    """Status, output and errors of some commands in one process that has the packages on its path."""
    session = str(site / "session.h5")
    commands = {
        "identify": ["identify", session, "--engine", "spring", "--option", "ridge=0.1", "--json", "-"],
        "compare": ["compare", session, "--engines", "spring,lms", "--json", "-"],
        "misspelt": ["identify", session, "--engine", "sprung"],
    }
    path = os.pathsep.join(filter(None, [str(site), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        [sys.executable, "-c", COMMANDS],
        env=os.environ | {"PYTHONPATH": path},
        input=json.dumps(commands),
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_it_is_identified_with(ended):
    status, out, err = ended["identify"]
    assert status == 0, err
    answer = json.loads(out)
    assert answer["engine"] == "spring"
    assert answer["options"] == {"ridge": 0.1}
    assert answer["n_parameters"] == 2
    assert 0 < answer["vaf_validation_percent"] < 95
    assert answer["findings"] == ["a spring is all that was looked for"]
    assert "'broken' (broken_tissue:Engine) was left out: half installed" in err


def test_it_is_compared_with_ours(ended):
    status, out, err = ended["compare"]
    assert status == 0, err
    answer = json.loads(out)
    assert [row["engine"] for row in answer["engines"]] == ["spring", "lms"]
    assert all(row["refused"] is None for row in answer["engines"])
    assert answer["engines"][0]["family"] == "linear"
    assert answer["recommendation"]["engine"] == "lms"


def test_its_name_is_offered(ended):
    status, _, err = ended["misspelt"]
    assert status == 2
    assert "spring" in err.splitlines()[-1]
