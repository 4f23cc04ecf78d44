"""From saved tests to fitted, validated and compared models: what the command line, the window and reports share."""

from tissueid.analysis.ceiling import known_ceiling, repeats
from tissueid.analysis.comparison import ComparisonEntry, EngineComparison, compare, specifications
from tissueid.analysis.fitting import Analysis, analyse, analyse_all, engines_of, fit_split
from tissueid.analysis.option_sweeps import SWEPT_MEMORY_S, SweepRow
from tissueid.analysis.scoring import Scored
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
