"""Validation of models: scores, residual tests, prediction, distortion, repeats, bootstrap."""

from tissueid.identification.base import aic, aicc, vaf_percent
from tissueid.identification.validation.scores import Score, score, validate, validated

__all__ = [
    "Score",
    "aic",
    "aicc",
    "score",
    "vaf_percent",
    "validate",
    "validated",
]
