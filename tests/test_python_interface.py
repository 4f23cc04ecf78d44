"""The public Python interface: its names, docstrings, types and page, and the tutorial that uses it."""

from __future__ import annotations

import inspect
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from coded import coded
from pages import ROOT, blocks
from reports.synthetic_sitting import make_session

import tissueid
from tissueid.sessions import Session, write_session

NAMES = [name for name in tissueid.__all__ if name != "__version__"]
FUNCTIONS = [name for name in NAMES if inspect.isfunction(getattr(tissueid, name))]
CLASSES = [name for name in NAMES if inspect.isclass(getattr(tissueid, name))]


@pytest.fixture(scope="module")
def session() -> Session:
    return make_session()


def test_import_is_light():
    """No Qt, no numpy and no module of a layer is imported before a name is used."""
    code = "import tissueid, sys, json; print(json.dumps([sorted(sys.modules), dir(tissueid)]))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    modules, names = json.loads(done.stdout)
    heavy = {"numpy", "scipy", "pydantic", "PySide6", "matplotlib", "typer"}
    assert {name.partition(".")[0] for name in modules} & heavy == set()
    light = {"tissueid", "tissueid.lazy_import", "tissueid.version"}
    assert {name for name in modules if name.startswith("tissueid")} == light
    assert names == sorted(tissueid.__all__)


def test_every_name_is_a_function_or_a_class():
    assert sorted(FUNCTIONS + CLASSES) == sorted(NAMES)
    assert tissueid.__all__ == sorted(tissueid.__all__)
    with pytest.raises(AttributeError, match="no attribute 'identfy'"):
        tissueid.identfy  # noqa: B018


def members() -> Iterator[tuple[str, object]]:
    """Yield every public name, and every public method and property that a class of the project declares."""
    for name in NAMES:
        value = getattr(tissueid, name)
        yield name, value
        for kind in value.__mro__ if name in CLASSES else ():
            if kind.__module__.startswith("tissueid."):
                for attribute, member in vars(kind).items():
                    if not attribute.startswith("_") and (
                        callable(member) or isinstance(member, property | classmethod)
                    ):
                        yield f"{name}.{attribute}", member


def test_docstrings_cover_the_whole_interface():
    """100 % of names and members: of more than fifty, none is without."""
    found = dict(members())
    assert len(found) > 50
    assert [name for name, member in found.items() if not (inspect.getdoc(member) or "").strip()] == []


@pytest.mark.parametrize("name", FUNCTIONS)
def test_each_function_documents_and_types_its_arguments(name: str):
    function = getattr(tissueid, name)
    text = inspect.getdoc(function) or ""
    signature = inspect.signature(function)
    for parameter in signature.parameters.values():
        assert parameter.annotation is not inspect.Parameter.empty, parameter.name
        assert name == "vaf_percent" or re.search(rf"^\s+{parameter.name}: ", text, re.MULTILINE), parameter.name
    assert signature.return_annotation is not inspect.Signature.empty


def test_the_page_names_them_all():
    page = (ROOT / "docs" / "python-interface.md").read_text(encoding="utf-8")
    assert [name for name in NAMES if not re.search(rf"`{name}[(`]", page)] == []


def test_records_and_sessions_give_the_same_fit(session: Session, tmp_path: Path):
    path = tmp_path / "session.h5"
    write_session(path, session)
    from_file = tissueid.identify(str(path), "lms", memory=0.05).model.report
    from_record = tissueid.identify(session.test().record(), "lms", memory=0.05).model.report
    assert from_record.parameters["mass_kg"] == from_file.parameters["mass_kg"]
    assert from_record.options["memory"] == 0.05
    joint = tissueid.identify([session.test().record()] * 2, "lms")
    assert joint.tests == (1, 2)


def test_records_can_be_compared(session: Session):
    found = tissueid.compare(session.test().record(), ["lms"], options={"lms": {"memory": 0.05}})
    assert list(found.analyses) == ["lms"]


def test_lists_include_all_kinds():
    assert {"lms", "dpn"} <= set(tissueid.list_engines())
    assert {"noise", "rtig"} <= set(tissueid.list_stimuli())
    assert tissueid.list_effects()["quadratic_drag"].stage == "mechanics"
    assert "simulated://forearm" in {found.url for found in tissueid.list_devices(probe=False)}


def test_files_are_imported(tmp_path: Path):
    time = np.arange(500) / 1000.0
    force, position = np.sin(60.0 * time), np.cos(50.0 * time)
    table = tmp_path / "rig.csv"
    np.savetxt(table, np.c_[time, force, position], delimiter=",", header="time_s,force_N,disp_mm", comments="")
    mapping = {"time": "time_s:s", "force": "force_N:N", "position": "disp_mm:mm"}
    made = tissueid.import_records(table, tmp_path / "rig.h5", mapping, sites=("bench",))
    assert made.tests[0].site == "bench"
    assert np.max(made.tests[0].signals["position"]) == pytest.approx(1e-3, rel=1e-3)


def test_bad_input_is_one_line_and_writes_nothing(session: Session, tmp_path: Path):
    with pytest.raises(tissueid.UnusableInputError, check=coded("registry.unknown_name")):
        tissueid.identify(session, "winer")
    with pytest.raises(tissueid.UnusableInputError, check=coded("scripting.calibration_kind")):
        tissueid.calibrate("simulated://spring", "dynamic")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="not int"):
        tissueid.identify(3)  # type: ignore[arg-type]
    with pytest.raises(tissueid.UnusableInputError):
        tissueid.run_test("simulated://forearm", "", tmp_path / "none.h5")
    with pytest.raises(tissueid.UnusableInputError):
        tissueid.open_session(tmp_path / "missing.h5")
    assert list(tmp_path.iterdir()) == []


def test_the_tutorial_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    code = blocks(ROOT / "docs" / "tutorials" / "python.md", "python")
    assert len(code) == 8
    for block in code:
        exec(compile(block, "docs/tutorials/python.md", "exec"), names)
    assert {path.name for path in tmp_path.iterdir()} == {"forearm.h5", "forearm.html"}
    assert "stiffness_n_per_m" in capsys.readouterr().out
