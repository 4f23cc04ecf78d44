"""Recipes of the figures and tables of the thesis: tests on simulated tissues, fits, and what the thesis found.

A recipe is one declaration in ``FIGURES``. Its tests are played on the simulated firmware, whose presets have the names
of the sites and systems of the thesis; its comparison holds the thesis' numbers and those of the fits.
"""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

from tissueid.language import marked
from tissueid_lab.thesis.comparisons import (
    ANTERIOR,
    ATTACHED,
    DISTAL,
    DPN,
    EXACT,
    LAGS_3,
    LAGS_5,
    LINEAR,
    MEMORIES_S,
    ORDERS,
    POSTERIOR,
    RELAXING,
    SITES,
    SKIN_SITES,
    TABLE_3_1,
    UPPER,
    WIENER,
    correlation_rows,
    direction_rows,
    frequency_rows,
    lobe_rows,
    localized_rows,
    loop_rows,
    memory_rows,
    orthonormalisation_study,
    partition_rows,
    partition_study,
    range_rows,
    repeat_rows,
    site_kernel_rows,
    technique_rows,
)
from tissueid_lab.thesis.inputs import INPUT_FIGURES
from tissueid_lab.thesis.kernels import KERNEL_FIGURES, LARGE
from tissueid_lab.thesis.recipe import RecipeSource, Recording, ThesisFigure
from tissueid_lab.thesis.signals import GAUSSIAN, SIGNAL_FIGURES


def _white(name: str, preset: str, force_n: tuple[float, float] = (-3.5, 10.5)) -> Recording:
    """Return a test with an input that is white at every fourth sample of 2 kHz: 500 Hz (thesis 4.3.3)."""
    return Recording(name, preset, force_n, seed=2, options=(("spectrum", "band"), ("cutoff_hz", 250.0)))


def _low_passed(cutoff_hz: float) -> Recording:
    """Return a test that stays on skin that relaxes, with noise up to a tenth of the sample rate (thesis 5.3.3)."""
    rate_hz, options = 10.0 * cutoff_hz, (("cutoff_hz", cutoff_hz),)
    name = f"{RELAXING}-{cutoff_hz:.0f}hz-at-{rate_hz:.0f}hz"
    return Recording(name, RELAXING, (0.5, 10.5), seed=1, distribution="gaussian", options=options, rate_hz=rate_hz)


def _localized(preset: str) -> tuple[Recording, ...]:
    """Return small tests of 1 N about successive loads (thesis 3.4)."""
    return tuple(
        Recording(f"{preset}-local-{load}", preset, (load - 0.5, load + 0.5), 2.0, load, "gaussian")
        for load in range(1, 11)
    )


def _attached(name: str, low_n: float, high_n: float, seconds: float = 4.0) -> Recording:
    """Return a test that pulls and pushes skin which is attached to the probe (thesis 3.4)."""
    name = f"{ATTACHED}-{name}"
    return Recording(name, ATTACHED, (low_n, high_n), seconds, 4, "gaussian", coupling="adhesive")


_LARGE = {POSTERIOR: LARGE} | {preset: Recording(f"{preset}-large", preset) for preset in (ANTERIOR, DISTAL, UPPER)}
_ELEVEN = Recording(f"{POSTERIOR}-11n", POSTERIOR, (0.0, 11.0), seed=6)
_WHITE = {preset: _white(f"{preset}-white", preset) for preset in (POSTERIOR, ANTERIOR, DISTAL, UPPER)}
_SYSTEMS = {
    LINEAR: ("linear", (0.5, 10.5)),
    WIENER: ("Wiener", (0.5, 10.5)),
    DPN: ("DPN", (0.5, 10.5)),
}
_SMALL_SHARE = 0.05
"""Share of the input range of the small tests of Fig. 3.11."""


def _range_tests() -> tuple[RecipeSource, ...]:
    """Return tests of 100 % and 5 % of the input range on three systems (Fig. 3.11)."""
    sources = []
    for preset, (label, (low, high)) in _SYSTEMS.items():
        middle, half = 0.5 * (low + high), 0.5 * _SMALL_SHARE * (high - low)
        sources.append(RecipeSource(label, Recording(f"{preset}-full", preset, (low, high))))
        sources.append(RecipeSource(label, Recording(f"{preset}-small", preset, (middle - half, middle + half))))
    return tuple(sources)


_INPUTS = (
    ("LMS", "74.3 %", "79.6 %"),
    ("Wiener", "+5", "+3"),
    ("first kernel", "85.5 %", "76 %"),
    ("second kernel", "94.6 %", "94.5 %"),
    ("filtered", "-4 to -5", "92.6 %"),
)
"""Fit, and VAF of low-passed and white input in the thesis (4.3.3)."""
_STRATEGIES = {
    "raw": "94.8 %",
    "filtered": "90.4 %",
    "downsampled": "96.4 %",
    "white": "94.5 %",
    "regularised": "not in the thesis",
}
"""Fit, and VAF in the thesis (Fig. 4.15)."""
_TEN_TESTS = tuple(
    RecipeSource(
        SKIN_SITES[preset],
        Recording(f"{preset}-repeat-{seed}", preset, (0.5, 10.5), seed=100 + seed, distribution="gaussian"),
    )
    for preset in TABLE_3_1
    for seed in range(10)
)
_COMPARED: tuple[ThesisFigure, ...] = (
    ThesisFigure(
        "3.4",
        marked("Autocorrelation of the force and its correlation with the position"),
        (RecipeSource("low-passed", _LARGE[POSTERIOR]),),
        ("lms",),
        ("correlations",),
        correlation_rows,
    ),
    ThesisFigure(
        "3.11",
        marked("Input ranges of 5 % and 100 % on a linear, a Wiener and a DPN system"),
        _range_tests(),
        ("wiener",),
        ("nonlinearity",),
        range_rows,
    ),
    ThesisFigure(
        "3.12",
        marked("Static nonlinearity with ranges of 11, 7 and 1 N, pushed, then pulled and pushed; responses by depth"),
        (
            RecipeSource("11 N", _ELEVEN),
            RecipeSource("7 N", Recording(f"{POSTERIOR}-7n", POSTERIOR, (2.0, 9.0), seed=5)),
            *(RecipeSource("1 N", recording) for recording in _localized(POSTERIOR)),
            RecipeSource("11 N, attached", _attached("11n", -5.5, 5.5)),
            RecipeSource("7 N, attached", _attached("7n", -3.5, 3.5)),
            *(RecipeSource("1 N, attached", _attached(f"local-{n + 6}", n - 0.5, n + 0.5, 2.0)) for n in range(-5, 6)),
        ),
        ("wiener",),
        ("nonlinearity", "impulse-by-depth"),
        loop_rows,
    ),
    ThesisFigure(
        "3.13",
        marked("Localized linear tests of two sites over the calibration, with Bode diagrams by depth"),
        tuple(RecipeSource(SITES[site], test) for site in (POSTERIOR, ANTERIOR) for test in _localized(site)),
        ("lms",),
        ("depth", "bode-by-depth"),
        localized_rows,
        calibration=True,
    ),
    ThesisFigure(
        "4.2",
        marked("Time of the orthonormalisation against the number of parameters"),
        study=orthonormalisation_study,
    ),
    ThesisFigure(
        "4.5",
        marked("Second-order kernel of a DPN system and of a Wiener system"),
        tuple(
            RecipeSource(label, _white(f"{preset}-white", preset, force_n))
            for label, preset, force_n in (("DPN", DPN, (-11.0, 11.5)), ("Wiener", WIENER, (0.5, 11.5)))
        ),
        (f"second={EXACT},downsample=1,memory=0.08",),
        ("second-kernels", "first-kernels"),
        lobe_rows,
        downsample=4,
    ),
    ThesisFigure(
        "4.8",
        marked("Second-order kernels of two sample rates"),
        (RecipeSource(SITES[POSTERIOR], _LARGE[POSTERIOR]),),
        (
            f"667 Hz={EXACT},{LAGS_3}",
            f"400 Hz={EXACT},{LAGS_5}",
        ),
        ("second-kernels",),
        vafs=(
            (marked("VAF, every 3rd sample"), "94.8 % (4.3.1), 95 %", "", "667 Hz"),
            (marked("VAF, every 5th sample"), "96.4 %", "", "400 Hz"),
        ),
    ),
    ThesisFigure(
        "4.12",
        marked("Filtered kernels of four sites"),
        tuple(RecipeSource(label, _LARGE[preset]) for preset, label in SITES.items()),
        (f"filtered={EXACT},downsample=3,smoothing=1",),
        ("second-kernels", "first-kernels"),
        site_kernel_rows,
    ),
    ThesisFigure(
        "4.13",
        marked("Low-passed against white input: linear, Wiener and Volterra"),
        (
            RecipeSource("low-passed", _LARGE[POSTERIOR], ("LMS", "Wiener", *(f"{n} at 667 Hz" for n in ORDERS))),
            RecipeSource("white", _WHITE[POSTERIOR], ("LMS", "Wiener", *(f"{n} at 500 Hz" for n in ORDERS))),
        ),
        (
            "LMS=lms",
            "Wiener=wiener",
            *(
                f"{label} at {rate} Hz={EXACT},downsample={step}{options}"
                for rate, step in ((667, 3), (500, 4))
                for label, options in ORDERS.items()
            ),
        ),
        ("second-kernels", "scores"),
        vafs=tuple(
            (f"VAF, {source}, {fit}", said[index], source, f"{fit} at {rate} Hz" if fit in ORDERS else fit)
            for index, (source, rate) in enumerate((("low-passed", 667), ("white", 500)))
            for fit, *said in _INPUTS
        ),
    ),
    ThesisFigure(
        "4.14",
        marked("Kernels of a white input at four sites, without a filter"),
        tuple(RecipeSource(label, _WHITE[preset]) for preset, label in SITES.items()),
        (f"white={EXACT},downsample=4",),
        ("second-kernels", "first-kernels"),
        site_kernel_rows,
    ),
    ThesisFigure(
        "4.15",
        marked("Strategies against noise in a second-order kernel"),
        (
            RecipeSource("low-passed", _LARGE[POSTERIOR], ("raw", "filtered", "downsampled", "regularised")),
            RecipeSource("white", _WHITE[POSTERIOR], ("white",)),
        ),
        (
            f"raw={EXACT},{LAGS_3}",
            f"filtered={EXACT},{LAGS_3},smoothing=1",
            f"downsampled={EXACT},{LAGS_5}",
            f"white={EXACT},downsample=4",
            "regularised=volterra",
        ),
        ("second-kernels",),
        vafs=tuple((f"VAF, {fit}", said, "", fit) for fit, said in _STRATEGIES.items()),
    ),
    ThesisFigure(
        "5.2",
        marked("Error of depth partitions against continuous length and repetitions"),
        study=partition_study,
    ),
    ThesisFigure(
        "5.6",
        marked("Six depth partitions of a Wiener system, a DPN system and skin (Figs. 5.6 to 5.8)"),
        (
            RecipeSource("Wiener", Recording(f"{WIENER}-full", WIENER, (0.5, 10.5))),
            RecipeSource("DPN", Recording(f"{DPN}-full", DPN, (0.5, 10.5))),
            RecipeSource(SITES[POSTERIOR], _LARGE[POSTERIOR]),
        ),
        ("depth,partitions=6,correct=false,memory=0.08,downsample=1",),
        ("partitions",),
        downsample=4,
        vafs=(
            (marked("VAF, Wiener system"), marked("near 96 %, 240 parameters"), "Wiener", ""),
            (marked("VAF, DPN system"), marked("not given"), "DPN", ""),
            (marked("VAF, skin"), "90.3 %", SITES[POSTERIOR], ""),
        ),
    ),
    ThesisFigure(
        "5.9",
        marked("Depth partitions against localized linear tests and the calibration, two sites"),
        (
            *(RecipeSource(SITES[p], test, ("lms",)) for p in (POSTERIOR, ANTERIOR) for test in _localized(p)),
            *(RecipeSource(SITES[p], _LARGE[p], ("depth",)) for p in (POSTERIOR, ANTERIOR)),
        ),
        ("lms", "depth"),
        ("depth",),
        partition_rows,
        calibration=True,
    ),
    ThesisFigure(
        "5.10",
        marked("Depth partitions with an input to 50 Hz and to 200 Hz"),
        (
            RecipeSource("50 Hz", _low_passed(50.0)),
            RecipeSource("200 Hz", _low_passed(200.0)),
        ),
        ("depth,correct=false",),
        ("depth",),
        frequency_rows,
    ),
    ThesisFigure(
        "5.11",
        marked("Depth partitions against direction partitions"),
        (RecipeSource(SITES[POSTERIOR], _ELEVEN),),
        ("depth,partitions=10", "direction,partitions=5"),
        ("depth",),
        direction_rows,
        vafs=(
            (marked("VAF, 10 depth partitions"), "91.9 %", "", "depth"),
            (marked("VAF, 5 partitions a direction"), "91.2 %", "", "direction"),
        ),
    ),
    ThesisFigure(
        "8.1",
        marked("VAF and AICc against memory"),
        (RecipeSource(SITES[POSTERIOR], _LARGE[POSTERIOR]),),
        (
            "LMS=lms,taper=0",
            "Wiener=wiener",
            f"first Volterra={EXACT},order=1,downsample=1",
            f"second Volterra={EXACT},downsample=1",
            "7 partitions=depth,correct=false,downsample=1",
        ),
        ("sweep",),
        memory_rows,
        downsample=4,
        sweep=("memory", MEMORIES_S),
    ),
    ThesisFigure(
        "Table 3.1",
        marked("Repeatability over ten tests at three sites"),
        _TEN_TESTS,
        ("LMS=lms", "Wiener=wiener,scaling=1000"),
        (),
        repeat_rows,
    ),
    ThesisFigure(
        "Table 8.1",
        marked("VAF, interpretability and time of four techniques"),
        (RecipeSource(SITES[POSTERIOR], _LARGE[POSTERIOR]),),
        ("LMS=lms", "Wiener=wiener", f"Volterra={EXACT},{LAGS_3}", "depth=depth,correct=false"),
        ("scores",),
        technique_rows,
    ),
)  # fmt: skip


def _place(figure: ThesisFigure) -> tuple[int, int, int]:
    """Return the order of a figure: by chapter, figures before tables, by number."""
    chapter, number = figure.number.removeprefix("Table ").split(".")
    return int(chapter), int(figure.number.startswith("Table")), int(number)


QUICK_TESTS = frozenset(
    [LARGE.name, GAUSSIAN.name, *(source.recording.name for figure in SIGNAL_FIGURES for source in figure.sources)]
)
"""Tests that a quick run plays; it leaves out the figures that need others."""
REMARKS = tomllib.loads(Path(__file__).with_name("remarks.toml").read_text(encoding="utf-8"))
"""What differs from the thesis by construction, by number of figure."""
FIGURES: tuple[ThesisFigure, ...] = tuple(
    replace(figure, remark=REMARKS.get(figure.number, ""))
    for figure in sorted((*_COMPARED, *SIGNAL_FIGURES, *KERNEL_FIGURES, *INPUT_FIGURES), key=_place)
)
"""The figures and tables, in the order of the thesis."""
