"""What a page says differently of a test that goes along the tissue and not into it: a displacement, no depth."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import replace

from tissueid.analysis import Analysis
from tissueid.configuration import has_depth, travel_word
from tissueid.language import _, marked
from tissueid.messages import translated
from tissueid.reports.blocks import Picture
from tissueid.sessions import Test

CONFIGURATIONS = (marked("indentation"), marked("extension"), marked("surface"))
"""Names of configurations, as a session has them."""
COUPLINGS = (marked("tape"), marked("adhesive"))
"""What attaches the probe, as a session has it."""
_DEPTH = re.compile(r"\b([Dd])epth(s?)\b")


def surface_of(test: Test) -> float:
    """Where depth is counted from, m; NaN where there is none."""
    return test.surface_position_m if has_depth(test.configuration) else math.nan


def captions_for_configuration(test: Test, pictures: Iterable[Picture]) -> tuple[Picture, ...]:
    """Return pictures whose texts say displacement where the configuration of the test has no depth."""
    if has_depth(test.configuration):
        return tuple(pictures)
    word = travel_word(test.configuration)

    def put(text: str) -> str:
        return _DEPTH.sub(lambda found: (word.capitalize() if found[1] == "D" else word) + found[2], text)

    return tuple(
        replace(
            one,
            heading=put(one.heading),
            alt=put(one.alt),
            caption=put(one.caption),
            missing=put(translated(one.missing)),
        )
        for one in pictures
    )


def spring_line(analyses: Iterable[Analysis]) -> str:
    """That an external spring was subtracted, and which; empty where there was none."""
    spring = max((analysis.external_spring_n_per_m for analysis in analyses), default=0.0)
    if not spring:
        return ""
    return _("The external spring of {spring:g} N/m is subtracted from every stiffness.").format(spring=spring)
