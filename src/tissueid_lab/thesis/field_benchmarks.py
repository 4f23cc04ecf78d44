"""Benchmarks of system identification: errors of the engines on published records, and published results.

The records are not part of the program: the file is named on the command line.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed
from tissueid.identification import engine_label, get_engine
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.procedures.control import Control
from tissueid.records import Record
from tissueid.sessions.imports import Choices, Source, import_test, parse_map
from tissueid_lab.thesis.recipe import NumberRow, Published, ReproducedFigure

_WARM = 50
"""Samples at the start of a test part that are not scored, as in the definition of both benchmarks."""


@dataclass(frozen=True)
class FieldBenchmark(Published):
    """A record with its parts, the engines that are fitted, and published results.

    ``fitted`` and ``tests`` are first sample and end of the parts, by name. ``engines`` are engine and options.
    ``published`` is a text for an engine and a part, or for "" and a part in a row of its own.
    """

    against: ClassVar[str] = marked("Published")
    mapping: tuple[str, ...]
    rate_hz: float
    samples: int
    fitted: tuple[int, int]
    tests: Mapping[str, tuple[int, int]]
    engines: tuple[tuple[str, Mapping[str, Any]], ...]
    published: Mapping[tuple[str, str], str]


_MULTISINE, _ARROW, _ARROW_INSIDE = "multisine", "arrow", "arrow without extrapolation"
SILVERBOX = FieldBenchmark(
    "Silverbox",
    marked("Mass on a hardening spring as an electronic circuit (Wigren and Schoukens 2013)"),
    ("input=V1:V", "output=V2:V"),
    1e7 / 2**14,
    131_072,
    (40_650, 60_650),
    {_MULTISINE: (105_712, 127_400), _ARROW: (100, 40_575), _ARROW_INSIDE: (100, 32_100)},
    (
        ("lms", {"memory": 0.25}),
        ("wiener", {"memory": 0.25}),
        ("dpn", {}),
    ),
    {
        ("lms", _MULTISINE): marked("linear: 6.96 mV (Champneys et al. 2024)"),
        ("lms", _ARROW): marked("linear: 14.4 and 14.2 mV (Champneys et al. 2024)"),
        ("lms", _ARROW_INSIDE): marked("linear: 6.58 and 6.59 mV (Champneys et al. 2024)"),
        ("dpn", _MULTISINE): marked("best: 0.30 mV, GP-NARX (Champneys et al. 2024); 0.36 mV, SUBNET"),
        ("dpn", _ARROW): marked(
            "best: 0.26 mV, polynomial nonlinear state space (Paduart 2008); others: 0.27, 0.30, 0.32, 0.34, "
            "0.35, 0.38, 0.60, 0.96, 1.3 and 1.4 mV"
        ),
        ("dpn", _ARROW_INSIDE): marked("best: 0.259 mV, GP-NARX (Champneys et al. 2024); 0.32 mV, SUBNET"),
    },
    remark=marked(
        "The linear error agrees with the published one. The circuit is a mass on a spring whose stiffness "
        "depends on the position, which is what the engine dpn fits; a Wiener curve cannot describe it. "
        "Inside the fitted amplitudes the error of dpn is below the best published errors. Where the arrow "
        "exceeds them, the curves of dpn extrapolate exponentially, which is the likely cause of the larger "
        "error. Parts are those of the loader nonlinear_benchmarks; only the first 20,000 of 65,062 samples "
        "for estimation are fitted, because a fit of all takes minutes."
    ),
)
WIENER_HAMMERSTEIN = FieldBenchmark(
    "Wiener-Hammerstein",
    marked("Curve between two linear filters (Schoukens, Suykens and Ljung 2009)"),
    ("input=u:V", "output=y:V"),
    51_200.0,
    188_000,
    (5_200, 25_200),
    {"test": (105_200, 184_000)},
    (
        ("lms", {"memory": 0.003}),
        ("cascade", {"memory": 0.003, "structure": "lnl"}),
    ),
    {
        ("lms", "test"): marked("linear: 43.4 mV (Champneys et al. 2024)"),
        ("cascade", "test"): marked(
            "best: 0.241 mV, SUBNET (Beintema, Toth and Schoukens 2021); 0.28 mV (Schoukens, Pintelon and Rolain "
            "2014); 0.294 mV, linear fractional representation; 1.2 mV, dynoNet; 3.97 mV, GRU"
        ),
    },
    remark=marked(
        "The linear error agrees with the published one. The structure LNL of the engine cascade has the "
        "blocks of the system, but not its rational filters: two third-order rational filters and a spline "
        "fitted to the same samples give 0.288 mV. Parts are those of the loader nonlinear_benchmarks; those "
        "of the definition of 2009 differ by less than 1 %. Only the first 20,000 of 100,000 samples for "
        "estimation are fitted."
    ),
)


def run_benchmark(benchmark: FieldBenchmark, path: Path, control: Control) -> ReproducedFigure:
    """Fit the engines to the estimation part of a record and score their free runs on its test parts.

    Args:
        benchmark: parts, engines and published results.
        path: MAT or CSV file of the record.
        control: progress and cancellation.

    Raises:
        UnusableInputError: the file cannot be read, or is another record.
        CancelledError: it was cancelled.
    """
    imported = import_test(Source.parsed(str(path)), parse_map(benchmark.mapping), Choices(), rate_hz=benchmark.rate_hz)
    record = imported.test.record()
    if len(record) != benchmark.samples:
        raise UnusableInputError(
            "reproduce.other_record",
            "{path} has {count} samples, but the record {name} has {expected}: name the file of the benchmark",
            path=str(path),
            count=len(record),
            name=benchmark.number,
            expected=benchmark.samples,
        )
    begin = time.perf_counter()
    rows = []
    for index, (engine, options) in enumerate(benchmark.engines):
        control.check()
        step = Message("reproduce.benchmark", "{name}: fitting {engine}", name=benchmark.number, engine=engine)
        control.progress(index / len(benchmark.engines), step)
        started = time.perf_counter()
        model = get_engine(engine).from_options(dict(options)).fit(record[slice(*benchmark.fitted)])
        spent = time.perf_counter() - started
        for name, part in benchmark.tests.items():
            error_mv = 1e3 * free_run_error(model.simulate, record[slice(*part)])
            published = benchmark.published.get((engine, name), marked("not quoted"))
            what = f"{engine_label(engine)}, {name}: RMS error of the free run"
            rows.append(NumberRow(what, published, f"{fixed(error_mv, 2)} mV ({fixed(spent, 0)} s)"))
    return ReproducedFigure(benchmark, tuple(rows), seconds=time.perf_counter() - begin)


def free_run_error(simulate: Any, record: Record) -> float:
    """Return the root-mean-square error of a simulation of a record after its first ``_WARM`` samples."""
    error = (record.output - simulate(record.input))[_WARM:]
    return float(np.sqrt(np.nanmean(error**2)))
