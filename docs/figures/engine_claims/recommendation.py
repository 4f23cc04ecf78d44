"""Recommended model for records of known systems."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from identification import simulated, simulated_dpn

from engine_claims.base import Claim
from tissueid.analysis import compare, specifications, split_records
from tissueid.identification import Family
from tissueid.records import Record

_ENGINES = ("lms", "wiener", "volterra", "dpn")
_RUNS = 5
_ASKED = 0.9

_SYSTEMS: tuple[tuple[str, Callable[[int], Record], Family], ...] = (
    ("linear, 40 dB", lambda seed: simulated.linear_record(seed), Family.LINEAR),
    ("linear, 20 dB, coloured", lambda seed: simulated.linear_record(seed, snr_db=20.0, colour=0.9), Family.LINEAR),
    ("Wiener, 30 dB", lambda seed: simulated.wiener_record(seed), Family.STATIC),
    (
        "parameters that follow depth, 40 dB",
        lambda seed: simulated_dpn.record(simulated_dpn.SKIN, seed),
        Family.PARAMETRIC,
    ),
)


def claims() -> list[Claim]:
    """How often the description of the system that made the record is recommended."""
    found = []
    for name, make, family in _SYSTEMS:
        chosen = Counter(
            compare(specifications(_ENGINES), split_records([make(300 + seed)])).recommendation.family
            for seed in range(_RUNS)
        )
        others = ", ".join(f"{times} times {other}" for other, times in chosen.items() if other is not family)
        found.append(
            Claim(
                f"recommended among {', '.join(_ENGINES)} for a system that is {name}",
                f"{family} in 90 % of runs",
                f"{chosen[family]} of {_RUNS}{'; ' if others else ''}{others}",
                chosen[family] >= _ASKED * _RUNS,
            )
        )
    return found
