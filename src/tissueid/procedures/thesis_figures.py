"""Recipes of the figures and tables of the thesis: tests on simulated tissues, fits, and what the thesis found.

A recipe is one declaration in ``FIGURES``. Its tests are played on the simulated firmware, whose presets have the names
of the sites and systems of the thesis; its comparison sets the thesis' numbers beside those of the fits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tissueid.analysis.curves.kernel_overlay import kernel_lobes
from tissueid.analysis.curves.overlay import loop_width
from tissueid.analysis.overlay import Overlay, OverlayEntry, RepeatedValue, repeated_values, series_profiles
from tissueid.analysis.partition_error import partition_errors
from tissueid.formatting import fixed, number
from tissueid.identification.engines.lms import LmsModel
from tissueid.identification.volterra.model import VolterraModel
from tissueid.language import marked
from tissueid.reports.overlay import DrawnFigures, partition_error_figures
from tissueid.reports.reproduction import Row

if TYPE_CHECKING:
    from tissueid.identification.depth_profile import DepthProfile

POSTERIOR, ANTERIOR = "left-posterior-forearm", "left-anterior-forearm"
DISTAL, UPPER = "left-distal-forearm", "upper-arm"
LINEAR, WIENER, DPN = "linear-demo", "wiener-demo", "dpn-demo"


@dataclass(frozen=True)
class Recording:
    """A test on a simulated tissue: noise over a range of force, N, after its preload.

    ``options`` are further options of the noise. ``name`` is that of its file.
    """

    name: str
    preset: str
    force_n: tuple[float, float] = (-3.5, 10.5)
    seconds: float = 4.0
    seed: int = 1
    distribution: str = "uniform"
    options: tuple[tuple[str, Any], ...] = ()


@dataclass(frozen=True)
class Source:
    """A recording in a figure: its label, and the labels of the fits that are run on it; empty for all."""

    label: str
    recording: Recording
    fits: tuple[str, ...] = ()


@dataclass(frozen=True)
class ThesisFigure:
    """A figure or table: tests, fits ([LABEL=]ENGINE,OPTION=VALUE), pictures, and the comparison.

    ``pictures`` are keys of ``reports.overlay``; the other arguments are those of ``analysis.overlay.overlay``.
    ``study`` makes figures and rows of a figure without tests instead; its argument is whether the run is quick.
    """

    number: str
    title: str
    sources: tuple[Source, ...]
    fits: tuple[str, ...]
    pictures: tuple[str, ...]
    rows: Callable[[Overlay], Sequence[Row]]
    whole: bool = True
    downsample: int = 1
    sweep: tuple[str, tuple[float, ...]] = ("", ())
    calibration: bool = False
    study: Callable[[bool], tuple[DrawnFigures, Sequence[Row]]] | None = None


def _white(name: str, preset: str, force_n: tuple[float, float] = (-3.5, 10.5)) -> Recording:
    """Return a test with an input that is white at every fourth sample of 2 kHz: 500 Hz (thesis 4.3.3)."""
    return Recording(name, preset, force_n, seed=2, options=(("spectrum", "band"), ("cutoff_hz", 250.0)))


def _low_passed(cutoff_hz: float) -> Recording:
    """Return a test that stays on the skin, with noise up to a cutoff (thesis 5.3.3)."""
    name, options = f"{POSTERIOR}-{cutoff_hz:.0f}hz", (("cutoff_hz", cutoff_hz),)
    return Recording(name, POSTERIOR, (0.5, 10.5), seconds=8.0, seed=7, options=options)


def _localized(preset: str) -> tuple[Recording, ...]:
    """Return small tests of 1 N about successive loads (thesis 3.4)."""
    return tuple(
        Recording(f"{preset}-local-{load}", preset, (load - 0.5, load + 0.5), 2.0, load, "gaussian")
        for load in range(1, 11)
    )


_LARGE = {preset: Recording(f"{preset}-large", preset) for preset in (POSTERIOR, ANTERIOR, DISTAL, UPPER)}
_WHITE = {preset: _white(f"{preset}-white", preset) for preset in (POSTERIOR, ANTERIOR, DISTAL, UPPER)}
_SITES = {
    POSTERIOR: "left posterior forearm",
    DISTAL: "left distal forearm",
    ANTERIOR: "left anterior forearm",
    UPPER: "upper arm",
}
_SYSTEMS = {
    LINEAR: ("linear", (0.5, 10.5)),
    WIENER: ("Wiener", (0.5, 10.5)),
    DPN: ("DPN", (0.5, 10.5)),
}
_SMALL_SHARE = 0.05
"""Share of the input range of the small tests of Fig. 3.11."""


def _range_tests() -> tuple[Source, ...]:
    """Return tests of 100 % and 5 % of the input range on three systems (Fig. 3.11)."""
    found = []
    for preset, (label, (low, high)) in _SYSTEMS.items():
        middle, half = 0.5 * (low + high), 0.5 * _SMALL_SHARE * (high - low)
        found.append(Source(label, Recording(f"{preset}-full", preset, (low, high))))
        found.append(Source(label, Recording(f"{preset}-small", preset, (middle - half, middle + half))))
    return tuple(found)


# -- comparisons ------------------------------------------------------------------------------------------------------


def _entry(found: Overlay, source: str = "", fit: str = "") -> OverlayEntry:
    """Return the first entry of a source and a fit; "" for any."""
    return next(one for one in found.entries if source in ("", one.source) and fit in ("", one.fit.label))


def _vaf(found: Overlay, source: str = "", fit: str = "") -> float:
    """Return the VAF of the fitted samples, scheduled where the model has a schedule, percent."""
    entry = _entry(found, source, fit)
    report = entry.analysis.model.report
    return report.vaf_percent if entry.scheduled_percent is None else entry.scheduled_percent


def _percent(value: float) -> str:
    return f"{fixed(value, 1)} %"


def _correlation_rows(found: Overlay) -> list[Row]:
    record = next(iter(found.records.values()))
    u = record.input - np.nanmean(record.input)
    u = np.where(np.isfinite(u), u, 0.0)
    power = float(u @ u)
    first = next(lag for lag in range(1, u.size) if float(u[lag:] @ u[:-lag]) < 0.0)
    model = _entry(found).analysis.model
    assert isinstance(model, LmsModel)
    rest = max(abs(float(u[lag:] @ u[:-lag])) / power for lag in range(20, 200))
    milliseconds = 1e3 / record.sample_rate_hz
    return [
        Row(
            marked("autocorrelation of a force low-passed at 200 Hz"),
            marked("1 at lag zero, near zero elsewhere"),
            f"0 at {fixed(first * milliseconds, 1)} ms, at most {fixed(rest, 2)} beyond 10 ms",
        )
    ]


def _range_rows(found: Overlay) -> list[Row]:
    thesis = {
        "linear": marked("one line in both ranges"),
        "Wiener": marked("one curve in both ranges"),
        "DPN": marked("loops at 100 %, one-to-one at 5 %"),
    }
    rows = []
    for label, said in thesis.items():
        shares = []
        for range_percent, entry in zip((100, 5), [one for one in found.entries if one.source == label], strict=True):
            output = entry.analysis.record.output
            share = 100.0 * loop_width(entry) / float(np.nanmax(output) - np.nanmin(output))
            shares.append(f"{range_percent} %: {fixed(share, 1)} %")
        rows.append(Row(f"{label}, width of loops by travel", said, ", ".join(shares)))
    return rows


def _loop_rows(found: Overlay) -> list[Row]:
    said = {"11 N": marked("loops appear"), "7 N": marked("little looping"), "1 N": marked("least looping")}
    rows = []
    for label, thesis in said.items():
        widths = [loop_width(one) for one in found.entries if one.source == label]
        rows.append(Row(f"{label}, width of loops", thesis, f"{number(1e6 * float(np.median(widths)), 3)} µm"))
    return rows


def _stiffness_rows(found: Overlay, fit: str) -> list[Row]:
    series = series_profiles(found, from_surface=True)
    made = [(_SITES[site], series[_SITES[site], fit]) for site in (POSTERIOR, ANTERIOR)]
    rows = []
    for (site, profile), said in zip(
        made, (marked("stiffer at every depth"), marked("softer at every depth")), strict=True
    ):
        ends = f"{fixed(profile.stiffness[0], 0)} to {fixed(profile.stiffness[-1], 0)} N/m"
        rows.append(Row(f"{site}, K", said, f"{ends} from {_depths(profile)}"))
    (_, one), (_, other) = made
    shared = np.linspace(max(one.position[0], other.position[0]), min(one.position[-1], other.position[-1]), 20)
    ratio = np.interp(shared, one.position, one.stiffness) / np.interp(shared, other.position, other.stiffness)
    rows.append(
        Row(
            marked("K, posterior over anterior at the same depth"),
            marked("above 1"),
            f"{fixed(float(ratio.min()), 2)} to {fixed(float(ratio.max()), 2)}",
        )
    )
    return rows


def _depths(profile: DepthProfile) -> str:
    return f"{fixed(1e3 * float(profile.position[0]), 1)} to {fixed(1e3 * float(profile.position[-1]), 1)} mm"


def _localized_rows(found: Overlay) -> list[Row]:
    vafs = [one.analysis.model.report.vaf_percent for one in found.entries]
    lowest = min(vafs)
    mass = [profile.mass for key, profile in series_profiles(found).items() if key[1] == "lms"]
    spread = max(float(np.ptp(one) / one.mean()) for one in mass)
    return [
        Row(marked("VAF of each small test"), marked("better than 90 %"), f"{_percent(lowest)} or more"),
        *_stiffness_rows(found, "lms"),
        Row(marked("mass along depth"), marked("does not change appreciably"), f"± {fixed(50.0 * spread, 0)} %"),
    ]


def _lobe_rows(found: Overlay) -> list[Row]:
    model, simple = (_entry(found, source).analysis.model for source in ("DPN", "Wiener"))
    assert isinstance(model, VolterraModel)
    assert isinstance(simple, VolterraModel)
    assert model.kernel2 is not None
    assert simple.kernel2 is not None
    spacing_s = model.lag_spacing / model.sample_rate_hz
    lobes, other = kernel_lobes(model.kernel2, spacing_s), kernel_lobes(simple.kernel2, spacing_s)
    return [
        Row(marked("VAF of a second-order kernel on a DPN"), "95.8 %", _percent(_vaf(found, "DPN"))),
        Row(
            marked("width of the centre lobe over its lag"),
            marked("narrower than a Wiener system's"),
            f"{fixed(lobes.width_s / lobes.lag_s, 2)} against {fixed(other.width_s / other.lag_s, 2)}",
        ),
        Row(
            marked("side lobes of the opposite sign"),
            marked("two"),
            f"{fixed(100.0 * lobes.beside, 0)} % of the centre beside the diagonal "
            f"(Wiener: {fixed(100.0 * other.beside, 0)} %)",
        ),
    ]


def _rate_rows(found: Overlay) -> list[Row]:
    return [
        Row(marked("VAF, every 3rd sample"), "94.8 % (4.3.1), 95 %", _percent(_vaf(found, fit="667 Hz"))),
        Row(marked("VAF, every 5th sample"), "96.4 %", _percent(_vaf(found, fit="400 Hz"))),
    ]


def _site_kernel_rows(found: Overlay) -> list[Row]:
    peaks = []
    for source in found.sources:
        model = _entry(found, source).analysis.model
        assert isinstance(model, VolterraModel)
        assert model.kernel1 is not None
        peaks.append(f"{source} {fixed(1e3 * float(model.kernel1.max()), 0)}")
    return [
        Row(
            marked("peak of the first kernel, mm/(N·s)"),
            marked("rises as stiffness and damping fall"),
            ", ".join(peaks),
        )
    ]


_INPUT_ROWS = (
    ("LMS", "74.3 %", "79.6 %"),
    ("Wiener", "+5", "+3"),
    ("first kernel", "85.5 %", "76 %"),
    ("second kernel", "94.6 %", "94.5 %"),
    ("filtered", "-4 to -5", "92.6 %"),
)
"""Fit, and VAF of low-passed and white input in the thesis (4.3.3)."""


def _input_rows(found: Overlay) -> list[Row]:
    rows = []
    for place, (source, rate) in enumerate((("low-passed", 667), ("white", 500))):
        for fit, *thesis in _INPUT_ROWS:
            label = f"{fit} at {rate} Hz" if fit in _ORDERS else fit
            rows.append(Row(f"VAF, {source}, {fit}", thesis[place], _percent(_vaf(found, source, label))))
    return rows


def _strategy_rows(found: Overlay) -> list[Row]:
    thesis = {"raw": "94.8 %", "filtered": "90.4 %", "downsampled": "96.4 %", "white": "94.5 %"}
    rows = [Row(f"VAF, {fit}", said, _percent(_vaf(found, fit=fit))) for fit, said in thesis.items()]
    return [*rows, Row("VAF, regularised", "not in the thesis", _percent(_vaf(found, fit="regularised")))]


def _partition_study(quick: bool) -> tuple[DrawnFigures, list[Row]]:
    """Return the error of partitions against continuous length and repetitions (Fig. 5.2)."""
    lengths, repetitions = (20, 50, 100, 200, 500, 1000), (1, 2, 5, 10)
    errors = partition_errors(lengths, repetitions, range(1 if quick else 5))
    enough = [one.mean_percent for one in errors if one.points >= 500 and np.isfinite(one.mean_percent)]
    few = [one for one in errors if one.points < 500]
    said = ", ".join(
        f"{one.points}: {_percent(one.mean_percent) if np.isfinite(one.mean_percent) else 'no fit'}" for one in few
    )
    longest = max(errors, key=lambda one: one.points)
    return partition_error_figures(errors), [
        Row(marked("error of M, B and K from 500 samples on"), marked("under 5 %"), f"at most {_percent(max(enough))}"),
        Row(marked("with fewer samples"), marked("larger"), said),
        Row(
            marked("trend with length and repetitions"),
            marked("falls with both"),
            f"{_percent(longest.mean_percent)} at {longest.points}",
        ),
    ]


def _six_rows(found: Overlay) -> list[Row]:
    return [
        Row(marked("VAF, Wiener system"), marked("near 96 %, 240 parameters"), _percent(_vaf(found, "Wiener"))),
        Row(marked("VAF, DPN system"), marked("not given"), _percent(_vaf(found, "DPN"))),
        Row(marked("VAF, skin"), "90.3 %", _percent(_vaf(found, _SITES[POSTERIOR]))),
    ]


def _partition_rows(found: Overlay) -> list[Row]:
    rows = _stiffness_rows(found, "depth")
    series = series_profiles(found, from_surface=True)
    for preset in (POSTERIOR, ANTERIOR):
        site = _SITES[preset]
        small, large = series[site, "lms"], series[site, "depth"]
        inside = (large.position > small.position[0]) & (large.position < small.position[-1])
        for what, name, said in (
            ("K", "stiffness", marked("generally less stiff, same trend")),
            ("B", "damping", marked("more similar")),
        ):
            reference = np.interp(large.position[inside], small.position, getattr(small, name))
            ratio = getattr(large, name)[inside] / reference
            shown = f"{fixed(float(np.median(ratio)), 2)} (median)"
            rows.append(Row(f"{site}, {what} of partitions over small tests", said, shown))
    return rows


def _frequency_rows(found: Overlay) -> list[Row]:
    series = series_profiles(found, from_surface=True)
    low, high = series["50 Hz", "depth"], series["200 Hz", "depth"]
    shared = np.linspace(max(low.position[0], high.position[0]), min(low.position[-1], high.position[-1]), 20)
    rows = []
    for what, name, said in (
        ("K", "stiffness", marked("K rises as the cutoff falls")),
        ("B", "damping", marked("the same")),
        ("M", "mass", marked("the same")),
    ):
        ratio = np.interp(shared, low.position, getattr(low, name)) / np.interp(
            shared, high.position, getattr(high, name)
        )
        rows.append(Row(f"{what}, 50 Hz over 200 Hz", said, f"{fixed(float(np.median(ratio)), 2)} (median)"))
    return rows


def _direction_rows(found: Overlay) -> list[Row]:
    rows = [
        Row(marked("VAF, 10 depth partitions"), "91.9 %", _percent(_vaf(found, fit="depth"))),
        Row(marked("VAF, 5 partitions a direction"), "91.2 %", _percent(_vaf(found, fit="direction"))),
    ]
    profile = next(p for key, p in series_profiles(found).items() if key[1] == "direction")
    into, out = (profile.direction == way for way in (1, -1))
    for what, name, said in (
        ("M", "mass", marked("the same in and out")),
        ("B", "damping", marked("larger inwards, apart with depth")),
        ("K", "stiffness", marked("larger inwards, apart with depth")),
    ):
        values = getattr(profile, name)
        ratio = values[into] / values[out]
        rows.append(Row(f"{what}, in over out", said, f"{fixed(float(np.nanmedian(ratio)), 2)} (median)"))
    return rows


_MEMORIES_S = (0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.09, 0.1, 0.11, 0.12)


def _memory_rows(found: Overlay) -> list[Row]:
    def scores(fit: str) -> dict[float, tuple[float, float]]:
        return {
            round(1e3 * float(one.swept or 0.0)): (
                one.scheduled_percent or one.analysis.model.report.vaf_percent,
                float((one.analysis.model.report.aicc if one.scheduled_aicc is None else one.scheduled_aicc) or np.nan),
            )
            for one in found.entries
            if one.fit.label == fit
        }

    lms, wiener, second, depth = (scores(fit) for fit in ("LMS", "Wiener", "second Volterra", "7 partitions"))
    gain = np.mean([wiener[ms][0] - lms[ms][0] for ms in (60, 80, 100, 120)])
    lowest = min(second, key=lambda ms: second[ms][1])
    worst = next((ms for ms in sorted(second) if ms > lowest and second[ms][1] > lms[ms][1]), None)
    best = [ms for ms in sorted(depth) if depth[ms][1] <= min(one[ms][1] for one in (lms, wiener, second))]
    return [
        Row(marked("VAF of LMS, 30 and 60 lags of 2 ms"), marked("level from 30"), _two(lms)),
        Row(marked("gain of Wiener over LMS"), marked("about 5"), f"{fixed(float(gain), 1)}"),
        Row(marked("VAF of the second-order kernel at 60 lags"), marked("almost perfect"), _percent(second[120][0])),
        Row(marked("its lowest AICc"), marked("20 to 30 lags, then it rises"), f"{lowest // 2} lags"),
        Row(marked("its AICc is the worst"), marked("from 40 lags"), f"from {worst // 2} lags" if worst else "never"),
        Row(
            marked("7 partitions have the lowest AICc"),
            marked("from 30 lags"),
            f"from {_tail(best, sorted(depth))} lags",
        ),
    ]


def _two(scores: dict[float, tuple[float, float]]) -> str:
    return f"{_percent(scores[60][0])} and {_percent(scores[120][0])}"


def _tail(best: Sequence[float], every: Sequence[float]) -> str:
    """Return the number of lags from which a model is the best at every longer memory; "no" for none."""
    first = None
    for ms in reversed(every):
        if ms not in best:
            break
        first = ms
    return "no" if first is None else str(int(first // 2))


_TECHNIQUES = (
    ("LMS", marked("70 to 75 %"), marked("good"), "0.2 to 1.0 s"),
    ("Wiener", marked("75 to 80 %"), marked("good"), "2.0 to 5.0 s"),
    ("Volterra", marked("90 to 97 %"), marked("poor"), "80 to 100 s"),
    ("depth", marked("90 to 95 %"), marked("good"), "5.0 to 7.0 s"),
)
"""Technique, VAF, interpretability and time of Table 8.1."""


def _technique_rows(found: Overlay) -> list[Row]:
    rows = []
    for fit, vaf, read, seconds in _TECHNIQUES:
        entry = _entry(found, fit=fit)
        spent = entry.analysis.model.report.seconds or float("nan")
        here = f"{_percent(_vaf(found, fit=fit))}, {entry.fit.engine.family.interpretability}, {fixed(spent, 2)} s"
        rows.append(Row(fit, f"{vaf}, {read}, {seconds}", here))
    return rows


_TABLE_3_1 = {
    ANTERIOR: ((78.06, 2.33), (82.60, 1.96), (0.0194, 0.001), (4.84, 0.166), (7.42, 0.302), (0.191, 0.0153)),
    POSTERIOR: ((86.53, 0.72), (89.14, 0.58), (0.0259, 0.0004), (5.22, 0.0843), (9.77, 0.145), (0.154, 0.0162)),
    DISTAL: ((76.05, 1.65), (81.33, 1.62), (0.0235, 0.0012), (7.00, 0.222), (4.71, 0.360), (0.442, 0.0327)),
}
"""Mean and standard deviation over ten tests of each quantity at each site."""
_QUANTITIES = (
    ("LMS", "vaf_percent", marked("linear nonparametric VAF (%)"), 1.0, 2),
    ("Wiener", "vaf_percent", marked("nonlinear VAF (%)"), 1.0, 2),
    ("Wiener", "scaled_mass_s2", marked("scaled mass (s²)"), 1.0, 4),
    ("Wiener", "scaled_damping_s", marked("scaled damping (s)"), 1.0, 2),
    ("Wiener", "c1_m", "C1 (mm)", 1e3, 2),
    ("Wiener", "c2_per_n", "C2 (1/N)", 1.0, 3),
)
"""Fit, quantity, label, factor and decimals of the rows of Table 3.1."""


def _repeat_rows(found: Overlay) -> list[Row]:
    values: dict[tuple[str, str, str], RepeatedValue] = {
        (one.source, one.fit, one.quantity): one for one in repeated_values(found)
    }
    rows = []
    for preset, thesis in _TABLE_3_1.items():
        site = _SITES[preset]
        for (fit, quantity, label, scale, decimals), (mean, std) in zip(_QUANTITIES, thesis, strict=True):
            one = values[site, fit, quantity]
            here = f"{fixed(scale * one.mean, decimals)} ± {number(scale * one.std, 2)}"
            rows.append(Row(f"{site}, {label}", f"{mean} ± {std}", here))
    return rows


def _repeats(count: int) -> tuple[Source, ...]:
    return tuple(
        Source(_SITES[preset], Recording(f"{preset}-repeat-{seed}", preset, seed=100 + seed))
        for preset in _TABLE_3_1
        for seed in range(count)
    )


_ORDERS = {"first kernel": ",order=1", "second kernel": "", "filtered": ",smoothing=15"}
"""Fits of Fig. 4.13 by kernels, and their options."""
_TEN = 10
_EXACT = "volterra,method=exact"
FIGURES: tuple[ThesisFigure, ...] = (
    ThesisFigure(
        "3.4",
        marked("Autocorrelation of the force and its correlation with the position"),
        (Source("low-passed", _LARGE[POSTERIOR]),),
        ("lms",),
        ("correlations",),
        _correlation_rows,
    ),
    ThesisFigure(
        "3.11",
        marked("Input ranges of 5 % and 100 % on a linear, a Wiener and a DPN system"),
        _range_tests(),
        ("wiener",),
        ("nonlinearity",),
        _range_rows,
    ),
    ThesisFigure(
        "3.12",
        marked("Static nonlinearity with ranges of 11, 7 and 1 N, and impulse responses by depth"),
        (
            Source("11 N", Recording(f"{POSTERIOR}-11n", POSTERIOR, (0.0, 11.0), seed=6)),
            Source("7 N", Recording(f"{POSTERIOR}-7n", POSTERIOR, (2.0, 9.0), seed=5)),
            *(Source("1 N", one) for one in _localized(POSTERIOR)),
        ),
        ("wiener",),
        ("nonlinearity", "impulse-by-depth"),
        _loop_rows,
    ),
    ThesisFigure(
        "3.13",
        marked("Localized linear tests of two sites over the calibration, with Bode diagrams by depth"),
        tuple(Source(_SITES[preset], one) for preset in (POSTERIOR, ANTERIOR) for one in _localized(preset)),
        ("lms",),
        ("depth", "bode-by-depth"),
        _localized_rows,
        calibration=True,
    ),
    ThesisFigure(
        "4.5",
        marked("Second-order kernel of a DPN system beside that of a Wiener system"),
        tuple(
            Source(label, _white(f"{preset}-white", preset, force_n))
            for label, preset, force_n in (("DPN", DPN, (-11.0, 11.5)), ("Wiener", WIENER, (0.5, 11.5)))
        ),
        (f"second={_EXACT},downsample=1,memory=0.08",),
        ("second-kernels", "first-kernels"),
        _lobe_rows,
        downsample=4,
    ),
    ThesisFigure(
        "4.8",
        marked("Second-order kernels of two sample rates"),
        (Source(_SITES[POSTERIOR], _LARGE[POSTERIOR]),),
        (
            f"667 Hz={_EXACT},downsample=3,rows=downsampled",
            f"400 Hz={_EXACT},downsample=5,rows=downsampled",
        ),
        ("second-kernels",),
        _rate_rows,
    ),
    ThesisFigure(
        "4.12",
        marked("Filtered kernels of four sites"),
        tuple(Source(label, _LARGE[preset]) for preset, label in _SITES.items()),
        (f"filtered={_EXACT},downsample=3,smoothing=15",),
        ("second-kernels", "first-kernels"),
        _site_kernel_rows,
    ),
    ThesisFigure(
        "4.13",
        marked("Low-passed against white input: linear, Wiener and Volterra"),
        (
            Source("low-passed", _LARGE[POSTERIOR], ("LMS", "Wiener", *(f"{one} at 667 Hz" for one in _ORDERS))),
            Source("white", _WHITE[POSTERIOR], ("LMS", "Wiener", *(f"{one} at 500 Hz" for one in _ORDERS))),
        ),
        (
            "LMS=lms",
            "Wiener=wiener",
            *(
                f"{label} at {rate} Hz={_EXACT},downsample={step}{options}"
                for rate, step in ((667, 3), (500, 4))
                for label, options in _ORDERS.items()
            ),
        ),
        ("second-kernels", "scores"),
        _input_rows,
    ),
    ThesisFigure(
        "4.14",
        marked("Kernels of a white input at four sites, without a filter"),
        tuple(Source(label, _WHITE[preset]) for preset, label in _SITES.items()),
        (f"white={_EXACT},downsample=4",),
        ("second-kernels", "first-kernels"),
        _site_kernel_rows,
    ),
    ThesisFigure(
        "4.15",
        marked("Strategies against noise in a second-order kernel"),
        (
            Source("low-passed", _LARGE[POSTERIOR], ("raw", "filtered", "downsampled", "regularised")),
            Source("white", _WHITE[POSTERIOR], ("white",)),
        ),
        (
            f"raw={_EXACT},downsample=3",
            f"filtered={_EXACT},downsample=3,smoothing=15",
            f"downsampled={_EXACT},downsample=5",
            f"white={_EXACT},downsample=4",
            "regularised=volterra",
        ),
        ("second-kernels",),
        _strategy_rows,
    ),
    ThesisFigure(
        "5.2",
        marked("Error of depth partitions against continuous length and repetitions"),
        (),
        (),
        (),
        lambda _found: (),
        study=_partition_study,
    ),
    ThesisFigure(
        "5.6",
        marked("Six depth partitions of a Wiener system, a DPN system and skin (Figs. 5.6 to 5.8)"),
        (
            Source("Wiener", Recording(f"{WIENER}-full", WIENER, (0.5, 10.5))),
            Source("DPN", Recording(f"{DPN}-full", DPN, (0.5, 10.5))),
            Source(_SITES[POSTERIOR], _LARGE[POSTERIOR]),
        ),
        ("depth,partitions=6,correct=false,memory=0.08,downsample=1",),
        ("partitions",),
        _six_rows,
        downsample=4,
    ),
    ThesisFigure(
        "5.9",
        marked("Depth partitions against localized linear tests and the calibration, two sites"),
        (
            *(Source(_SITES[p], one, ("lms",)) for p in (POSTERIOR, ANTERIOR) for one in _localized(p)),
            *(Source(_SITES[p], _LARGE[p], ("depth",)) for p in (POSTERIOR, ANTERIOR)),
        ),
        ("lms", "depth"),
        ("depth",),
        _partition_rows,
        calibration=True,
    ),
    ThesisFigure(
        "5.10",
        marked("Depth partitions with an input to 50 Hz and to 200 Hz"),
        (
            Source("50 Hz", _low_passed(50.0)),
            Source("200 Hz", _low_passed(200.0)),
        ),
        ("depth",),
        ("depth",),
        _frequency_rows,
    ),
    ThesisFigure(
        "5.11",
        marked("Depth partitions against direction partitions"),
        (Source(_SITES[POSTERIOR], _LARGE[POSTERIOR]),),
        ("depth,partitions=10", "direction,partitions=5"),
        ("depth",),
        _direction_rows,
    ),
    ThesisFigure(
        "8.1",
        marked("VAF and AICc against memory"),
        (Source(_SITES[POSTERIOR], _LARGE[POSTERIOR]),),
        (
            "LMS=lms,taper=0",
            "Wiener=wiener",
            f"first Volterra={_EXACT},order=1,downsample=1",
            f"second Volterra={_EXACT},downsample=1",
            "7 partitions=depth,correct=false,downsample=1",
        ),
        ("sweep",),
        _memory_rows,
        downsample=4,
        sweep=("memory", _MEMORIES_S),
    ),
    ThesisFigure(
        "Table 3.1",
        marked("Repeatability over ten tests at three sites"),
        _repeats(_TEN),
        ("LMS=lms", "Wiener=wiener,scaling=1000"),
        (),
        _repeat_rows,
    ),
    ThesisFigure(
        "Table 8.1",
        marked("VAF, interpretability and time of four techniques"),
        (Source(_SITES[POSTERIOR], _LARGE[POSTERIOR]),),
        ("LMS=lms", "Wiener=wiener", f"Volterra={_EXACT},downsample=3,rows=downsampled", "depth=depth,correct=false"),
        ("scores",),
        _technique_rows,
    ),
)  # fmt: skip
"""The figures and tables, in the order of the thesis."""
