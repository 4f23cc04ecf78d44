"""Identification: engines that turn a record into a model, and the scores that say how good it is."""

from tissueid.identification.base import Engine, FitReport, Model
from tissueid.identification.family import Family
from tissueid.identification.registry import engine, engine_names, get_engine
from tissueid.identification.validation import Score, aic, aicc, vaf_percent, validate, validated

__all__ = [
    "Engine",
    "Family",
    "FitReport",
    "Model",
    "Score",
    "aic",
    "aicc",
    "engine",
    "engine_names",
    "get_engine",
    "vaf_percent",
    "validate",
    "validated",
]
