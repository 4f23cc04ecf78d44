"""The public Python interface: the functions of ``import tissueid`` (docs/python-interface.md).

They take paths as text or ``Path``, work without a person, and return the frozen results of the layers below.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tissueid.errors import UnusableInputError
from tissueid.messages import Verbatim
from tissueid.records import Record
from tissueid.sessions import Session, read_session

if TYPE_CHECKING:  # each takes long to import
    from tissueid.analysis import Analysis, EngineComparison
    from tissueid.analysis.split import Split
    from tissueid.gap import Diagnosis
    from tissueid.identification import Engine
    from tissueid.instrument import FoundInstrument
    from tissueid.procedures.calibrations import CalibrationResult
    from tissueid.stimuli import Stimulus, StimulusKind
    from tissueid.twin.effect import Effect

Source = str | os.PathLike[str] | Session | Record | Sequence[Record]
"""Where data comes from: a session file, a session, or one or several records."""


def open_session(path: str | os.PathLike[str]) -> Session:
    """Read a session file.

    The signals of a test are arrays in SI units: ``session.test(1).signals["force"]`` has shape (n,), and
    ``session.test(1).unit("force")`` is its unit. NaN marks a sample that was not received.
    ``session.test(1).record()`` is force and position without the preload, the data of every engine.

    Args:
        path: of the file. Its content is not trusted: a process with limits reads it.

    Returns:
        The session with all its tests.

    Raises:
        UnusableInputError: the file is missing, is no session, or is damaged.
    """
    return read_session(Path(path))


def import_records(
    files: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    out: str | os.PathLike[str],
    mapping: Mapping[str, str] | None = None,
    **options: Any,
) -> Session:
    """Import CSV, MAT or LVM files as a new session, one test for each file.

    Args:
        files: one or several files; ``rig.lvm@0:8000`` takes rows 0 to 7999.
        out: session file to write.
        mapping: column and unit of each signal, such as ``{"force": "Load cell:N", "position": "Probe:mm"}``; None for
            files of ``tissueid export``.
        options: fields of ``ImportPlan``, such as ``rate_hz=2000.0``, ``sites=("left forearm",)``, ``subject="P-001"``.

    Returns:
        The session; all values are converted to SI units.

    Raises:
        UnusableInputError: a file, a column, a unit or an option cannot be used.
        SessionExistsError: ``out`` exists; sessions are never overwritten.
    """
    from tissueid.procedures.control import Control
    from tissueid.procedures.import_export import ImportPlan, run_import
    from tissueid.procedures.instruments import audit_trail

    chosen = (files,) if isinstance(files, str | os.PathLike) else tuple(files)
    pairs = tuple(f"{role}={column}" for role, column in (mapping or {}).items())
    plan = ImportPlan(files=tuple(map(Path, chosen)), out=Path(out), mapping=pairs, **options)
    return run_import(plan, Control(), audit_trail()).session


def list_engines() -> dict[str, type[Engine]]:
    """Return the identification engines, those of plug-ins included, by name.

    Each has a ``title``, a ``family``, and its options with defaults, bounds and descriptions in ``model_fields``.
    """
    from tissueid.identification import engine_names, get_engine

    return {name: get_engine(name) for name in engine_names()}


def list_stimuli() -> dict[str, type[StimulusKind]]:
    """Return the kinds of stimuli, those of plug-ins included, by name; their options are in ``model_fields``."""
    from tissueid.stimuli import get_stimulus, stimulus_names

    return {name: get_stimulus(name) for name in stimulus_names()}


def list_effects() -> dict[str, Effect]:
    """Return the effects that a diagnosis can name, those of plug-ins included, by name."""
    from tissueid.twin.catalogue import all_effects

    return dict(all_effects())


def list_devices(*, probe: bool = True) -> list[FoundInstrument]:
    """Return connected and simulated instruments; ``url`` is the address for ``run_test``.

    Args:
        probe: whether to connect to each and ask what it is. The coil stays free.
    """
    from tissueid.procedures.instruments import DevicesPlan, listed_instruments

    return listed_instruments(DevicesPlan(probe=probe))


def make_stimulus(kind: str, **options: Any) -> Stimulus:
    """Generate the samples of a stimulus, without preload and without an instrument.

    Args:
        kind: one of ``list_stimuli()``, such as "noise" or "multisine".
        options: options of the kind, such as ``seconds=4.0, force_min_n=0.5, force_max_n=10.5, seed=1``.

    Returns:
        The stimulus with its ``values``, shape (n,), in ``unit`` (N or V) at ``sample_rate_hz``.

    Raises:
        UnusableInputError: the kind or an option is unknown or out of bounds, or the kind is generated during a test.
    """
    from tissueid.stimuli import build_stimulus

    return build_stimulus(kind, options)


def identify(
    data: Source,
    engine: str = "wiener",
    *,
    test: int | None = None,
    also: Sequence[int] = (),
    validate: int | None = None,
    input_name: str = "force",
    output_name: str = "position",
    tissue_alone: bool = False,
    **options: Any,
) -> Analysis:
    """Fit an engine to a test, and score its free-run simulation on held-out samples.

    Args:
        data: a session file, a session, or records (of records, the last quarter is held out).
        engine: one of ``list_engines()``.
        test: number of the test; None for the first stochastic one.
        also: numbers of tests that are fitted jointly with it.
        validate: number of the held-out test; None holds out the last quarter.
        input_name: signal that is the input.
        output_name: signal that is the output.
        tissue_alone: also report mass and damping without the moving part of the instrument.
        options: options of the engine, such as ``memory=0.06``.

    Returns:
        The analysis. ``analysis.model`` has ``simulate(u)``, ``predict(record, horizon)`` and ``residuals(record)``;
        ``analysis.model.report`` has ``vaf_percent`` (Eq. 3.13), ``vaf_validation_percent``, and ``parameters`` with
        their standard deviations (None where the data gives none). ``analysis.depth_profile()`` is mass, damping and
        stiffness against depth, or None.

    Raises:
        UnusableInputError: the data, the engine or an option cannot be used; the message gives the reason.
    """
    from tissueid.analysis import analyse, fit_split
    from tissueid.identification import get_engine

    records = _records_of(data)
    if records is None:
        return analyse(
            _session_of(data),
            engine,
            options,
            test=test,
            also=also,
            validate=validate,
            input_name=input_name,
            output_name=output_name,
            tissue_alone=tissue_alone,
        )
    return fit_split(get_engine(engine).from_options(options), _split_of(records))


def compare(
    data: Source,
    engines: Sequence[str] | None = None,
    *,
    test: int | None = None,
    validate: int | None = None,
    options: Mapping[str, Mapping[str, Any]] | None = None,
) -> EngineComparison:
    """Fit several engines to one test, and recommend the description that it supports.

    Args:
        data: a session file, a session, or records.
        engines: their names; None for all.
        test: number of the test; None for the first stochastic one.
        validate: number of the held-out test; None holds out the last quarter.
        options: options of engines, by the name of the engine.

    Returns:
        The comparison, with the scores as ``entries`` (or the reason why an engine refused the record), ``analyses`` by
        engine, and the ``recommendation`` with its reasons.

    Raises:
        UnusableInputError: the data cannot be used, an engine is unknown, or every engine refused the record.
    """
    from tissueid.analysis import compare as compare_split
    from tissueid.analysis import specifications
    from tissueid.procedures.control import Control
    from tissueid.procedures.identification import compare_engines

    chosen = specifications(engines, own=options)
    records = _records_of(data)
    if records is None:
        return compare_engines(_session_of(data), chosen, Control(), test=test, validate=validate).comparison
    return compare_split(chosen, _split_of(records))


def run_test(device: str, site: str, out: str | os.PathLike[str], **options: Any) -> Session:
    """Run a guided test: placement, preload, stimulus, release. All limits of force, stroke, heat and time apply.

    Args:
        device: address of the instrument, such as ``simulated://forearm?seed=1``, ``socket://HOST:PORT`` or a port.
        site: site on the body, or material.
        out: new session file.
        options: fields of ``TestPlan``, such as ``stimulus="noise"``, ``seconds=4.0``, ``max_force_n=8.0``, ``seed=1``,
            ``repeats=3``, ``subject="P-001"``. ``tissueid test --help`` describes them.

    Returns:
        The session that was written.

    Raises:
        UnusableInputError: an option cannot be used; nothing was moved or written.
        SessionExistsError: ``out`` exists; sessions are never overwritten.
        LimitError, InstrumentError: the test ended early. The coil is released, and the samples until then are saved.
    """
    from tissueid.procedures.instruments import audit_trail
    from tissueid.procedures.test_plan import TestPlan
    from tissueid.procedures.test_run import TestControl
    from tissueid.procedures.test_run import run_test as run_plan

    class Notices(TestControl):
        """Turns notices into warnings."""

        def notice(self, message: str) -> None:
            """Warn."""
            warnings.warn(str(message), stacklevel=2)

    plan = TestPlan(**{"url": device, "site": site, "out": Path(out)} | options)
    return run_plan(plan, Notices(), audit_trail()).saved()


def calibrate(
    device: str, kind: Literal["static", "sweep"] = "static", out: str | os.PathLike[str] | None = None, **options: Any
) -> CalibrationResult:
    """Calibrate an instrument on its spring, without a person.

    Args:
        device: address of the instrument.
        kind: "static" for force constant, resistance and sensors; "sweep" for the force constant along the stroke.
        out: new calibration file, TOML; None for one in the calibration folder, where tests find it.
        options: fields of ``StaticCalibrationPlan`` or ``DynamicSweepPlan``, such as ``spring_n_per_m=1000.0``.

    Returns:
        The result. ``result.calibration.quantities`` are values with standard deviations. A calibration whose
        ``verdict`` is "failed" is returned and saved too; tests never use it.

    Raises:
        UnusableInputError: an option cannot be used, or a step needs a person.
        LimitError, InstrumentError: the calibration ended early; the coil is released.
    """
    from tissueid.procedures.calibration_plans import DynamicSweepPlan, StaticCalibrationPlan
    from tissueid.procedures.calibrations import run_static_calibration, run_sweep
    from tissueid.procedures.control import Control
    from tissueid.procedures.instruments import audit_trail

    values = {"device": device, "out": None if out is None else Path(out)} | options
    if kind == "static":
        return run_static_calibration(StaticCalibrationPlan(**values), Control(), audit_trail("technician"))
    if kind == "sweep":
        return run_sweep(DynamicSweepPlan(**values), Control(), audit_trail("technician"))
    raise UnusableInputError(
        "scripting.calibration_kind", "the kind must be static or sweep, got '{kind}'", kind=Verbatim(kind)
    )


def diagnose(
    session: str | os.PathLike[str] | Session,
    *,
    fit: Sequence[int] = (),
    check: Sequence[int] = (),
    workers: int | None = None,
) -> Diagnosis:
    """Diagnose the gap between a session and its simulation. This takes some ten seconds to minutes.

    Args:
        session: a session file or a session.
        fit: numbers of the fitted tests; () for those chosen automatically.
        check: numbers of the held-out tests.
        workers: number of processes; None for one per core, 1 for none besides this one.

    Returns:
        The diagnosis, with ``verdict``, ``where`` (stage of the signal chain), ``ranking`` of the effects with their
        probabilities, ``combination`` of the named effects, and ``next_experiment``.

    Raises:
        UnusableInputError: the session cannot be diagnosed, such as one without voltage and current.
    """
    from tissueid.gap import diagnose as diagnose_dataset
    from tissueid.gap import executor, prepare
    from tissueid.gap.twin_export import against_twin

    dataset, effects = against_twin(prepare(_session_of(session), tuple(fit), tuple(check)), None)
    with executor(workers) as pool:
        return diagnose_dataset(dataset, pool, accepted=effects)


def write_report(
    session: str | os.PathLike[str] | Session,
    out: str | os.PathLike[str],
    *,
    test: int | None = None,
    engines: Sequence[str] | None = None,
    pdf: str | os.PathLike[str] | None = None,
) -> Path:
    """Write the report of a test: a self-contained HTML page with all figures.

    Args:
        session: a session file or a session.
        out: HTML page to write; a page of this program is replaced, other files are not.
        test: number of the test; None for the first stochastic one.
        engines: their names; None for those of the standard report.
        pdf: a short PDF to write in addition.

    Returns:
        The path of the page.

    Raises:
        UnusableInputError: the test or an engine is unknown, no engine can use the test, or a file cannot be written.
    """
    from tissueid.procedures.control import Control
    from tissueid.procedures.saved_test import ReportPlan, run_report

    names = None if engines is None else tuple(engines)
    files = {"page": Path(out), "pdf": None if pdf is None else Path(pdf)}
    plan = ReportPlan(session=Path(), test=test, engines=names, **files)
    run_report(plan, Control(), lambda: _session_of(session))
    return plan.page


def _session_of(data: Source) -> Session:
    if isinstance(data, str | os.PathLike):
        return open_session(data)
    if isinstance(data, Session):
        return data
    raise TypeError(f"give a session file, a session or records, not {type(data).__name__}")


def _records_of(data: Source) -> tuple[Record, ...] | None:
    """Return the records; None for a session or its file."""
    if isinstance(data, Record):
        return (data,)
    if isinstance(data, list | tuple) and all(isinstance(item, Record) for item in data):
        return tuple(data)
    return None


def _split_of(records: Sequence[Record]) -> Split:
    from tissueid.analysis import split_records

    return split_records(records, tuple(range(1, len(records) + 1)))
