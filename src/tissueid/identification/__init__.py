"""Identification: engines that turn a record into a model, and scores of its quality."""

from tissueid.identification.base import Engine, Family, FitReport, FittedCurve, LineFigure, Model
from tissueid.identification.registry import engine, engine_label, engine_names, get_engine, label_of, report_engines
from tissueid.identification.validation import Score, aic, aicc, vaf_percent, validate, validated

__all__ = [
    "Engine",
    "Family",
    "FitReport",
    "FittedCurve",
    "LineFigure",
    "Model",
    "Score",
    "aic",
    "aicc",
    "engine",
    "engine_label",
    "engine_names",
    "get_engine",
    "label_of",
    "report_engines",
    "vaf_percent",
    "validate",
    "validated",
]
