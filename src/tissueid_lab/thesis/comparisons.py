"""Comparisons of the figures and tables of the thesis: its numbers, and those of the fits of the same figure.

Each function takes the fits of a figure and returns its rows; ``figures`` declares the tests and fits.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tissueid.analysis.curves.kernels import Lobes, kernel_lobes
from tissueid.analysis.curves.overlay_plots import loop_width
from tissueid.analysis.overlay import Overlay, repeated_values, series_profiles
from tissueid.formatting import fixed, grouped, number
from tissueid.identification.engines.volterra import Volterra
from tissueid.identification.volterra.structure import VolterraModel
from tissueid.language import marked
from tissueid_lab.thesis.computing_times import (
    lags_for,
    orthonormalisation_times,
    shortest,
    technique_times,
    time_plot,
)
from tissueid_lab.thesis.published_algorithms import volterra
from tissueid_lab.thesis.recipe import NumberRow, Outcome, drawn_grid, entry_of, fitted, percent, shown_vaf
from tissueid_lab.thesis.simulated_systems import partition_error_plots, partition_errors

if TYPE_CHECKING:
    from tissueid.identification.depth_profile import DepthProfile

POSTERIOR, ANTERIOR = "left-posterior-forearm", "left-anterior-forearm"
DISTAL, UPPER = "left-distal-forearm", "upper-arm"
RELAXING, ATTACHED = "skin-anterior-relaxing", "forearm-attached"
LINEAR, WIENER, DPN = "linear-demo", "wiener-demo", "dpn-demo"
SKIN_ANTERIOR, SKIN_POSTERIOR, SKIN_DISTAL = "skin-anterior", "skin-posterior", "skin-distal"
SKIN_SITES = {
    SKIN_ANTERIOR: "anterior forearm",
    SKIN_POSTERIOR: "posterior forearm",
    SKIN_DISTAL: "distal side of the forearm",
}
"""Sites of Table 3.1, after whose numbers these tissues were made."""
SITES = {
    POSTERIOR: "left posterior forearm",
    DISTAL: "left distal forearm",
    ANTERIOR: "left anterior forearm",
    UPPER: "upper arm",
}
EXACT = "volterra,method=exact"
LAGS_3, LAGS_5 = (
    "downsample=3,memory=0.0615,rows=downsampled",
    "downsample=5,memory=0.0775,rows=downsampled",
)
"""Every 3rd and every 5th sample, with 41 and 31 lags: three rows remain for each parameter (thesis 4.3)."""
ORDERS = {"first kernel": ",order=1", "second kernel": "", "filtered": ",smoothing=1"}
"""Fits of Fig. 4.13 by kernels, and their options."""


def correlation_rows(overlay: Overlay) -> list[NumberRow]:
    """Return the first zero and the rest of the autocorrelation of the force (Fig. 3.4)."""
    record = next(iter(overlay.records.values()))
    u = record.input - np.nanmean(record.input)
    u = np.where(np.isfinite(u), u, 0.0)
    power = float(u @ u)
    first = next(lag for lag in range(1, u.size) if float(u[lag:] @ u[:-lag]) < 0.0)
    rest = max(abs(float(u[lag:] @ u[:-lag])) / power for lag in range(20, 200))
    milliseconds = 1e3 / record.sample_rate_hz
    return [
        NumberRow(
            marked("autocorrelation of a force low-passed at 200 Hz"),
            marked("1 at lag zero, near zero elsewhere"),
            f"0 at {fixed(first * milliseconds, 1)} ms, at most {fixed(rest, 2)} beyond 10 ms",
        )
    ]


def range_rows(overlay: Overlay) -> list[NumberRow]:
    """Return the width of the loops over the travel at both ranges (Fig. 3.11)."""
    thesis = {
        "linear": marked("one line in both ranges"),
        "Wiener": marked("one curve in both ranges"),
        "DPN": marked("loops at 100 %, one-to-one at 5 %"),
    }
    rows = []
    for label, said in thesis.items():
        shares = []
        for range_percent, entry in zip(
            (100, 5), [test for test in overlay.entries if test.source == label], strict=True
        ):
            output = entry.analysis.record.output
            share = 100.0 * loop_width(entry) / float(np.nanmax(output) - np.nanmin(output))
            shares.append(f"{range_percent} %: {fixed(share, 1)} %")
        rows.append(NumberRow(f"{label}, width of loops by travel", said, ", ".join(shares)))
    return rows


def loop_rows(overlay: Overlay) -> list[NumberRow]:
    """Return the width of the loops at each range, and the stiffness pulled and pushed (Fig. 3.12)."""
    said = {"11 N": marked("loops appear"), "7 N": marked("little looping"), "1 N": marked("least looping")}
    rows = []
    for label, thesis in said.items():
        for source in (label, f"{label}, attached"):
            widths = [loop_width(entry) for entry in overlay.entries if entry.source == source]
            rows.append(
                NumberRow(f"{source}, width of loops", thesis, f"{number(1e6 * float(np.median(widths)), 3)} µm")
            )
    profile = series_profiles(overlay, from_surface=True)["1 N, attached", "wiener"]
    away = float(min(-profile.position[0], profile.position[-1]))
    pulled, between, pushed = np.interp([-away, 0.0, away], profile.position, profile.stiffness)
    here = f"{fixed(pulled, 0)} and {fixed(pushed, 0)} N/m; {fixed(between, 0)} N/m at the surface"
    what = f"K of attached skin, pulled and pushed by {fixed(1e3 * away, 1)} mm"
    return [*rows, NumberRow(what, marked("rises faster when pulled"), here)]


def _stiffness_rows(overlay: Overlay, fit: str) -> list[NumberRow]:
    series = series_profiles(overlay, from_surface=True)
    made = [(SITES[site], series[SITES[site], fit]) for site in (POSTERIOR, ANTERIOR)]
    rows = []
    for (site, profile), said in zip(
        made, (marked("stiffer at every depth"), marked("softer at every depth")), strict=True
    ):
        ends = f"{fixed(profile.stiffness[0], 0)} to {fixed(profile.stiffness[-1], 0)} N/m"
        rows.append(NumberRow(f"{site}, K", said, f"{ends} from {_depths(profile)}"))
    (_, posterior), (_, anterior) = made
    shared = np.linspace(
        max(posterior.position[0], anterior.position[0]), min(posterior.position[-1], anterior.position[-1]), 20
    )
    ratio = np.interp(shared, posterior.position, posterior.stiffness) / np.interp(
        shared, anterior.position, anterior.stiffness
    )
    rows.append(
        NumberRow(
            marked("K, posterior over anterior at the same depth"),
            marked("above 1"),
            f"{fixed(float(ratio.min()), 2)} to {fixed(float(ratio.max()), 2)}",
        )
    )
    return rows


def _depths(profile: DepthProfile) -> str:
    return f"{fixed(1e3 * float(profile.position[0]), 1)} to {fixed(1e3 * float(profile.position[-1]), 1)} mm"


def localized_rows(overlay: Overlay) -> list[NumberRow]:
    """Return VAF, stiffness and mass of the small tests (Fig. 3.13)."""
    vafs = [item.analysis.model.report.vaf_percent for item in overlay.entries]
    lowest = min(vafs)
    mass = [profile.mass for key, profile in series_profiles(overlay).items() if key[1] == "lms"]
    spread = max(float(np.ptp(item) / item.mean()) for item in mass)
    return [
        NumberRow(marked("VAF of each small test"), marked("better than 90 %"), f"{percent(lowest)} or more"),
        *_stiffness_rows(overlay, "lms"),
        NumberRow(marked("mass along depth"), marked("does not change appreciably"), f"± {fixed(50.0 * spread, 0)} %"),
    ]


def lobe_rows(overlay: Overlay) -> list[NumberRow]:
    """Return VAF and lobes of the kernel of a DPN system and of a Wiener system (Fig. 4.5)."""
    lobes, other = (_lobes(overlay, source) for source in ("DPN", "Wiener"))
    return [
        NumberRow(marked("VAF of a second-order kernel on a DPN"), "95.8 %", shown_vaf(overlay, "DPN")),
        NumberRow(
            marked("width of the centre lobe over its lag"),
            marked("narrower than a Wiener system's"),
            f"{fixed(lobes.width_s / lobes.lag_s, 2)} against {fixed(other.width_s / other.lag_s, 2)}",
        ),
        NumberRow(
            marked("side lobes of the opposite sign"),
            marked("two"),
            f"{fixed(100.0 * lobes.side_lobe, 0)} % of the centre (Wiener: {fixed(100.0 * other.side_lobe, 0)} %)",
        ),
    ]


def _lobes(overlay: Overlay, source: str) -> Lobes:
    model, _record, _part = fitted(overlay, VolterraModel, source=source)
    assert model.kernel2 is not None
    return kernel_lobes(model.kernel2, model.lag_spacing / model.sample_rate_hz)


def site_kernel_rows(overlay: Overlay) -> list[NumberRow]:
    """Return the peaks of the first-order kernels of the sites (Figs. 4.12, 4.14)."""
    peaks = []
    for source in overlay.sources:
        model, _record, _part = fitted(overlay, VolterraModel, source=source)
        assert model.kernel1 is not None
        peaks.append(f"{source} {fixed(1e3 * float(model.kernel1.max()), 0)}")
    return [
        NumberRow(
            marked("peak of the first kernel, mm/(N·s)"),
            marked("rises as stiffness and damping fall"),
            ", ".join(peaks),
        )
    ]


def partition_study(quick: bool) -> Outcome:
    """Return the error of partitions against continuous length and repetitions (Fig. 5.2)."""
    lengths: tuple[int, ...] = (20, 50, 100, 200, 500, 1000)
    repetitions: tuple[int, ...] = (1, 2, 5, 10)
    if quick:
        lengths, repetitions = (50, 200), (1, 5)
    errors = partition_errors(lengths, repetitions, range(1 if quick else 5))
    enough = [error.mean_percent for error in errors if error.points >= 500 and np.isfinite(error.mean_percent)]
    few = [error for error in errors if error.points < 500]
    said = ", ".join(
        f"{error.points}: {percent(error.mean_percent) if np.isfinite(error.mean_percent) else 'no fit'}"
        for error in few
    )
    longest = max(errors, key=lambda error: error.points)
    return drawn_grid(
        "partition-error",
        marked("Error of depth partitions"),
        marked("Error against continuous samples, and against all samples, a line for each number of repetitions."),
        [partition_error_plots(errors)],
        caption=marked(
            "Mean error of mass, damping and stiffness on a simulated Wiener system with five levels of force and "
            "a memory of 60 samples. Dashed: 5 %."
        ),
        row_height=3.6,
        over=True,
    ), [
        NumberRow(
            marked("error of M, B and K from 500 samples on"), marked("under 5 %"), f"at most {percent(max(enough))}"
        ),
        NumberRow(marked("with fewer samples"), marked("larger"), said),
        NumberRow(
            marked("trend with length and repetitions"),
            marked("falls with both"),
            f"{percent(longest.mean_percent)} at {longest.points}",
        ),
    ]


def partition_rows(overlay: Overlay) -> list[NumberRow]:
    """Return stiffness and damping of partitions relative to small tests (Fig. 5.9)."""
    rows = _stiffness_rows(overlay, "depth")
    series = series_profiles(overlay, from_surface=True)
    for preset in (POSTERIOR, ANTERIOR):
        site = SITES[preset]
        small, large = series[site, "lms"], series[site, "depth"]
        inside = (large.position > small.position[0]) & (large.position < small.position[-1])
        for what, name, said in (
            ("K", "stiffness", marked("generally less stiff, same trend")),
            ("B", "damping", marked("more similar")),
        ):
            reference = np.interp(large.position[inside], small.position, getattr(small, name))
            ratio = getattr(large, name)[inside] / reference
            shown = f"{fixed(float(np.median(ratio)), 2)} (median)"
            rows.append(NumberRow(f"{site}, {what} of partitions over small tests", said, shown))
    return rows


def frequency_rows(overlay: Overlay) -> list[NumberRow]:
    """Return the parameters with a low cutoff relative to those with a high one (Fig. 5.10)."""
    series = series_profiles(overlay, from_surface=True)
    profiles = [series[source, "depth"] for source in ("50 Hz", "200 Hz")]
    fitted = [np.isfinite(profile.stiffness) for profile in profiles]  # not all kernels are those of such a system
    positions = [profile.position[good] for profile, good in zip(profiles, fitted, strict=True)]
    shared = np.linspace(max(position[0] for position in positions), min(position[-1] for position in positions), 20)
    rows = []
    for what, name, said in (
        ("K", "stiffness", marked("K rises as the cutoff falls")),
        ("B", "damping", marked("the same")),
        ("M", "mass", marked("the same")),
    ):
        low, high = (
            np.interp(shared, position, getattr(profile, name)[good])
            for position, profile, good in zip(positions, profiles, fitted, strict=True)
        )
        rows.append(NumberRow(f"{what}, 50 Hz over 200 Hz", said, f"{fixed(float(np.median(low / high)), 2)} (median)"))
    return rows


def direction_rows(overlay: Overlay) -> list[NumberRow]:
    """Return parameters of partitions by direction, in over out (Fig. 5.11)."""
    rows = []
    profile = next(p for key, p in series_profiles(overlay).items() if key[1] == "direction")
    into, out = (profile.direction == way for way in (1, -1))
    for what, name, said in (
        ("M", "mass", marked("the same in and out")),
        ("B", "damping", marked("larger inwards, more so with depth")),
        ("K", "stiffness", marked("larger inwards, more so with depth")),
    ):
        values = getattr(profile, name)
        ratio = values[into] / values[out]
        rows.append(NumberRow(f"{what}, in over out", said, f"{fixed(float(np.nanmedian(ratio)), 2)} (median)"))
    return rows


MEMORIES_S = (0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.09, 0.1, 0.11, 0.12)


def memory_rows(overlay: Overlay) -> list[NumberRow]:
    """Return where the curves of VAF and AICc against memory turn (Fig. 8.1)."""

    def scores(fit: str) -> dict[float, tuple[float, float]]:
        return {
            round(1e3 * float(entry.swept or 0.0)): (
                entry.shown_percent,
                float(
                    (entry.analysis.model.report.aicc if entry.scheduled_aicc is None else entry.scheduled_aicc)
                    or np.nan
                ),
            )
            for entry in overlay.entries
            if entry.fit.label == fit
        }

    lms, wiener, second, depth = (scores(fit) for fit in ("LMS", "Wiener", "second Volterra", "7 partitions"))
    longest = max(second)  # a short test has too few rows for a long memory
    gain = np.mean([wiener[ms][0] - lms[ms][0] for ms in (60, 80, 100, 120)])
    lowest = min(second, key=lambda ms: second[ms][1])
    worst = next((ms for ms in sorted(second) if ms > lowest and second[ms][1] > lms[ms][1]), None)
    record = next(iter(overlay.records.values()))
    memory = lags_for(len(record))
    inputs = record.input - record.input.mean()
    printed = shortest(lambda: volterra(inputs, record.output, memory))
    engine = Volterra(memory=(memory + 1) / record.sample_rate_hz, downsample=1, method="exact")
    here = shortest(lambda: engine.fit(record))
    best = [
        ms
        for ms in sorted(depth)
        if depth[ms][1] <= min(curve[ms][1] for curve in (lms, wiener, second) if ms in curve)
    ]
    return [
        NumberRow(
            marked("VAF of LMS, 30 and 60 lags of 2 ms"),
            marked("level from 30"),
            f"{percent(lms[60][0])} and {percent(lms[120][0])}",
        ),
        NumberRow(marked("gain of Wiener over LMS"), marked("about 5"), f"{fixed(float(gain), 1)}"),
        NumberRow(
            marked("VAF of the second-order kernel at 60 lags"),
            marked("almost perfect"),
            f"{percent(second[longest][0])} at {longest // 2}",
        ),
        NumberRow(marked("its lowest AICc"), marked("20 to 30 lags, then it rises"), f"{lowest // 2} lags"),
        NumberRow(
            marked("its AICc is the worst"), marked("from 40 lags"), f"from {worst // 2} lags" if worst else "never"
        ),
        NumberRow(
            marked("7 partitions have the lowest AICc"),
            marked("from 30 lags"),
            f"from {_tail(best, sorted(depth))} lags",
        ),
        NumberRow(
            f"second order, {memory} lags: time here; of the thesis' algorithm on this computer",
            marked("not given"),
            f"{number(here, 2)} s; {number(printed, 2)} s",
        ),
    ]


def _tail(best: Sequence[float], every: Sequence[float]) -> str:
    """Return the number of lags from which a model is the best at every longer memory; "no" for none."""
    first = None
    for ms in reversed(every):
        if ms not in best:
            break
        first = ms
    return "no" if first is None else str(int(first // 2))


_MEMORIES, _QUICK_MEMORIES = (5, 8, 12, 16, 20, 25, 30, 35, 40), (5, 8, 12)
"""Lags of the fits of Fig. 4.2: up to 903 parameters."""
_TECHNIQUES = (
    ("LMS", marked("70 to 75 %"), marked("good"), "0.2 to 1.0 s"),
    ("Wiener", marked("75 to 80 %"), marked("good"), "2.0 to 5.0 s"),
    ("Volterra", marked("90 to 97 %"), marked("poor"), "80 to 100 s"),
    ("depth", marked("90 to 95 %"), marked("good"), "5.0 to 7.0 s"),
)
"""Technique, VAF, interpretability and time of Table 8.1."""


def technique_rows(overlay: Overlay) -> list[NumberRow]:
    """Return VAF, interpretability and time of each technique, and the time of the thesis' algorithm (Table 8.1)."""
    printed = technique_times(next(iter(overlay.records.values())))
    rows = []
    for fit, vaf, read, seconds in _TECHNIQUES:
        entry = entry_of(overlay, fit=fit)
        engine, analysis = entry.fit.engine, entry.analysis
        spent = shortest(lambda: engine.fit(analysis.record, analysis.fit_part))  # noqa: B023 - called at once
        here = f"{shown_vaf(overlay, fit=fit)}, {engine.family.interpretability}"
        rows.append(NumberRow(f"{fit}: VAF, interpretability", f"{vaf}, {read}", here))
        times = f"{number(spent, 2)} s; {number(printed[fit], 2)} s"
        rows.append(NumberRow(f"{fit}: time here; of the thesis' algorithm on this computer", seconds, times))
    return rows


def orthonormalisation_study(quick: bool) -> Outcome:
    """Return the time of the orthonormalisation against the number of parameters (Fig. 4.2)."""
    timings = orthonormalisation_times(_QUICK_MEMORIES if quick else _MEMORIES)
    thesis, stored, here, again = timings
    most = grouped(thesis.sizes[-1])
    ratio = thesis.seconds[-1] / stored.seconds[-1]
    return drawn_grid(
        "times",
        marked("Time against the number of parameters"),
        marked("Seconds against parameters for the thesis' algorithm and for the one used here."),
        [[time_plot(timings, marked("Parameters"))]],
        row_height=3.8,
    ), [
        NumberRow(marked("power of the number of parameters, thesis' algorithm"), "2", fixed(thesis.power, 2)),
        NumberRow(
            marked("orthonormalisation over solution"), marked("one to two orders of magnitude"), fixed(ratio, 1)
        ),
        NumberRow(
            f"{most} parameters: thesis' algorithm; here",
            marked("80 to 100 s in all (Table 8.1)"),
            f"{number(thesis.seconds[-1], 2)} s; {number(here.seconds[-1], 2)} s",
        ),
        NumberRow(
            f"{most} parameters, second output: thesis' algorithm; here",
            marked("one to two orders of magnitude less"),
            f"{number(stored.seconds[-1], 2)} s; {number(again.seconds[-1], 2)} s",
        ),
    ]


TABLE_3_1 = {
    SKIN_ANTERIOR: ((78.06, 2.33), (82.60, 1.96), (0.0194, 0.001), (4.84, 0.166), (7.42, 0.302), (0.191, 0.0153)),
    SKIN_POSTERIOR: ((86.53, 0.72), (89.14, 0.58), (0.0259, 0.0004), (5.22, 0.0843), (9.77, 0.145), (0.154, 0.0162)),
    SKIN_DISTAL: ((76.05, 1.65), (81.33, 1.62), (0.0235, 0.0012), (7.00, 0.222), (4.71, 0.360), (0.442, 0.0327)),
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


def repeat_rows(overlay: Overlay) -> list[NumberRow]:
    """Return mean and standard deviation of each quantity at each site (Table 3.1)."""
    values = {(repeated.source, repeated.fit, repeated.quantity): repeated for repeated in repeated_values(overlay)}
    rows = []
    for preset, thesis in TABLE_3_1.items():
        site = SKIN_SITES[preset]
        for (fit, quantity, label, scale, decimals), (mean, std) in zip(_QUANTITIES, thesis, strict=True):
            repeated = values[site, fit, quantity]
            here = f"{fixed(scale * repeated.mean, decimals)} ± {number(scale * repeated.std, 2)}"
            rows.append(NumberRow(f"{site}, {label}", f"{mean} ± {std}", here))
    return rows
