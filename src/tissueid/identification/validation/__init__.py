"""Validation of models: scores, residual tests, prediction, distortion, repeats, bootstrap."""

from tissueid.identification.validation.scores import (
    Score,
    aic,
    aicc,
    score,
    vaf_percent,
    validate,
    validated,
)

__all__ = [
    "Score",
    "aic",
    "aicc",
    "score",
    "vaf_percent",
    "validate",
    "validated",
]
