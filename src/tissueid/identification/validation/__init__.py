"""How good a model is: scores, residual tests, prediction, distortion, repeats, bootstrap."""

from tissueid.identification.validation.scores import (
    Score,
    aic,
    aicc,
    complete_windows,
    finite_runs,
    part_mask,
    score,
    scored_samples,
    vaf_percent,
    validate,
    validated,
)

__all__ = [
    "Score",
    "aic",
    "aicc",
    "complete_windows",
    "finite_runs",
    "part_mask",
    "score",
    "scored_samples",
    "vaf_percent",
    "validate",
    "validated",
]
