"""Candidates of a recommendation and their scores relative to each other on held-out samples."""

from __future__ import annotations

from dataclasses import dataclass

from tissueid.identification.base import Array
from tissueid.identification.model_family import Family
from tissueid.identification.validation.paired_difference import Difference


@dataclass(frozen=True, eq=False)
class Candidate:
    """An engine fitted to the record.

    ``error`` (n,) is measured minus free-run simulated output on the held-out record, NaN where it is not scored.
    ``parameters`` is the effective number of parameters. ``vaf_percent`` and ``aicc`` are scores on the fitted
    samples, ``scheduled_percent`` is the held-out VAF with the measured output as the schedule. ``second_order`` marks
    a linear model reduced to mass, damping and stiffness.
    """

    engine: str
    family: Family
    error: Array
    parameters: float
    vaf_percent: float
    aicc: float | None = None
    scheduled_percent: float | None = None
    second_order: bool = False


@dataclass(frozen=True)
class Standing:
    """Scores of a candidate, as in :class:`Candidate`, and their differences from other candidates on held-out samples.

    ``behind`` is the lead of the best candidate over this one, ``below`` the lead of the recommended one; ``beaten`` is
    true if any candidate has a significant and relevant lead over it.
    """

    engine: str
    family: Family
    second_order: bool
    vaf_percent: float
    vaf_fitted_percent: float
    scheduled_percent: float | None
    aicc: float | None
    behind: Difference
    below: Difference
    beaten: bool


@dataclass(frozen=True)
class SufficientOption:
    """An option of the recommended engine: the smallest value that scores as well as any value tried."""

    option: str
    value: float
    tried: tuple[float, ...]
    vaf_percent: tuple[float, ...]
