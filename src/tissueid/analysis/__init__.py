"""From saved tests to fitted, validated and compared models: what the command line, the window and reports share."""

from tissueid.analysis.comparison import (
    SWEPT_MEMORY_S,
    ComparisonEntry,
    EngineComparison,
    SweepRow,
    compare,
    known_ceiling,
    repeats,
    specifications,
)
from tissueid.analysis.fitting import Analysis, Scored, analyse, analyse_all, engines_of, fit_split
from tissueid.analysis.split import FIT_SHARE, Split, split, split_records

__all__ = [
    "FIT_SHARE",
    "SWEPT_MEMORY_S",
    "Analysis",
    "ComparisonEntry",
    "EngineComparison",
    "Scored",
    "Split",
    "SweepRow",
    "analyse",
    "analyse_all",
    "compare",
    "engines_of",
    "fit_split",
    "known_ceiling",
    "repeats",
    "specifications",
    "split",
    "split_records",
]
