"""Results of the steps of a calibration: quantities, tables, problems and notes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from tissueid.calibration.file import CalibratedQuantity
from tissueid.errors import UnusableInputError
from tissueid.records import Estimate


@dataclass(frozen=True)
class CalibrationFindings:
    """Results of one step. ``problems`` make the verdict a failure; ``notes`` do not.

    ``shared`` is the part of a quantity's standard deviation that is common to all repeats, in the quantity's unit,
    such as the uncertainty of the spring.
    """

    quantities: dict[str, CalibratedQuantity] = field(default_factory=dict)
    tables: dict[str, dict[str, tuple[float, ...]]] = field(default_factory=dict)
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    shared: dict[str, float] = field(default_factory=dict)

    def value(self, name: str) -> float:
        """Return the value of a quantity from an earlier step.

        Raises:
            UnusableInputError: no step has measured it.
        """
        if name not in self.quantities:
            raise UnusableInputError("calibration.no_quantity", "the calibration does not contain {name}", name=name)
        return self.quantities[name].value

    def __add__(self, other: CalibrationFindings) -> CalibrationFindings:
        return CalibrationFindings(
            self.quantities | other.quantities,
            self.tables | other.tables,
            self.problems + other.problems,
            self.notes + other.notes,
            {name: std for name, std in self.shared.items() if name not in other.quantities} | other.shared,
        )


def quantity(estimate: Estimate | float, unit: str, std: float | None = None) -> CalibratedQuantity:
    """Return a quantity of a calibration file. A standard deviation that is not finite is omitted.

    Standard deviations of an inverted channel, scaled by a negative value, are made positive.
    """
    found = estimate if isinstance(estimate, Estimate) else Estimate(estimate, std)
    known = None if found.std is None or not np.isfinite(found.std) else abs(float(found.std))
    return CalibratedQuantity(value=float(found.value), std=known, unit=unit)


def column(values: ArrayLike) -> tuple[float, ...]:
    """Return a column of a table, rounded to seven digits."""
    return tuple(float(f"{value:.7g}") for value in np.asarray(values, np.float64))


def mean_of_repeats(runs: Sequence[CalibrationFindings]) -> CalibrationFindings:
    """Return the mean of several runs of the same steps.

    The random part of the standard deviation of a mean is the larger of the runs' own estimate and their scatter,
    divided by the square root of their number; the part shared by all runs is not reduced. A problem of one run is a
    problem of the result. The table ``repeats`` holds the quantities of each run; other tables are from the first run.
    """
    first = runs[0]
    if len(runs) == 1:
        return first
    names = [name for name in first.quantities if all(name in run.quantities for run in runs)]
    quantities = {}
    for name in names:
        values = np.array([run.quantities[name].value for run in runs])
        stds = [run.quantities[name].std for run in runs]
        own = float(np.mean([std for std in stds if std is not None])) if None not in stds else 0.0
        scatter = float(np.std(values, ddof=1))
        shared = float(np.mean([run.shared.get(name, 0.0) for run in runs]))
        random = max(float(np.sqrt(max(0.0, own**2 - shared**2))), scatter) / len(runs) ** 0.5
        quantities[name] = quantity(float(values.mean()), first.quantities[name].unit, float(np.hypot(shared, random)))
    repeats = {"run": column(np.arange(1, len(runs) + 1))} | {
        name: column([run.quantities[name].value for run in runs]) for name in names
    }
    return CalibrationFindings(
        quantities,
        first.tables | {"repeats": dict(list(repeats.items())[:50])},
        tuple(dict.fromkeys(problem for run in runs for problem in run.problems)),
        tuple(dict.fromkeys(note for run in runs for note in run.notes)),
        first.shared,
    )
