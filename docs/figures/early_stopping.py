"""How soon a test is as good as 4 s of the default noise: measures it on the skin presets and draws the picture.

Fifty tests with each stimulus on each preset of the simulated instrument, converters and sensor noise included. Prints
the tables; ``--write`` makes ``docs/images/early-stopping.png`` and, beside it, the figures as JSON.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from stopping_study import (
    CURVE_PRESETS,
    HALF_S,
    LENGTH_S,
    LOADS_N,
    PARAMETERS,
    RUNS,
    SKIN,
    STIMULI,
    TIMES,
    Array,
    after_half,
    appraised,
    course,
    curves,
    pooled_times,
    stopped,
    times_to_reference,
    variants,
)

from tissueid.errors import UnusableInputError
from tissueid.reports.style import BLUE, DASHES, GREEN, MUTED, ORANGE, drawing, new_figure, plain_image

PICTURE = Path(__file__).parents[1] / "images" / "early-stopping.png"
MEASURES = ("told", "spread", "error")
DEFAULT_PRESET = "left-posterior-forearm"


def percents(values: Sequence[float] | Array, form: str = ".2g") -> str:
    """Shares as percent, mass, damping, stiffness."""
    return ", ".join(format(100.0 * float(value), form) for value in values) + " %"


def rounded(values: Array) -> list[Any]:
    """Nested lists of values to five places, for JSON."""
    nested: list[Any] = np.round(values, 5).tolist()
    return nested


def seconds_text(values: Sequence[float]) -> str:
    """Times, mass, damping, stiffness."""
    return ", ".join(f"{value:.2f}" if np.isfinite(value) else "never" for value in values) + " s"


def report(presets: Sequence[str]) -> dict[str, Any]:
    """All figures, printed as they come."""
    found: dict[str, Any] = {"loads_n": LOADS_N, "runs": RUNS, "times_s": TIMES.tolist(), "presets": {}}
    for preset in presets:
        ours, theirs = course(preset, "designed"), course(preset, "gaussian")
        times, ends = times_to_reference(preset), stopped(preset, "designed")
        half = int(np.searchsorted(TIMES, HALF_S))
        print(f"\n{preset}: mass, damping, stiffness")
        for measure in MEASURES:
            print(
                f"  {measure:7} gaussian 4 s {percents(getattr(theirs, measure)[-1])}; designed 2 s "
                f"{percents(getattr(ours, measure)[half])}; as good after {seconds_text(times[measure])}"
            )
        print(
            f"  stopped after {np.median(ends.seconds):.2f} s ({ends.seconds.min():g} to {ends.seconds.max():g}); "
            f"intervals hold their limit {percents(ends.held_limit, '.0f')}, "
            f"the plant {percents(ends.held_own, '.0f')}",
            flush=True,
        )
        found["presets"][preset] = {
            kind: {m: rounded(getattr(course(preset, kind), m)) for m in MEASURES} for kind in ("gaussian", "designed")
        } | {
            "as_good_after_s": {m: [t if np.isfinite(t) else None for t in each] for m, each in times.items()},
            "stopped_s": ends.seconds.tolist(),
        }
    found["pooled"] = {kind: pooled(presets, kind) for kind in ("gaussian", "designed")}
    for measure in MEASURES:
        print(f"pooled, {measure}: as good after {seconds_text(pooled_times(presets, measure))}")
    for preset in (p for p in CURVE_PRESETS if p in presets):
        whole, even = curves(preset, "gaussian", LENGTH_S), curves(preset, "even", HALF_S)
        print(f"\n{preset}: curves at {LOADS_N} N (dpn); fits without uncertainty {whole.unsettled}, {even.unsettled}")
        for place, name in enumerate(PARAMETERS):
            for what, one in (("gaussian 4 s", whole), ("even 2 s", even)):
                bias = np.median(one.value[:, place], axis=0) - one.own[place]
                print(
                    f"  {name:9} {what:12}: told {percents(one.told[place])}, spread {percents(one.spread[place])}, "
                    f"off {percents(bias)}",
                    flush=True,
                )
        found["presets"][preset]["curves"] = {
            what: {"told": rounded(one.told), "spread": rounded(one.spread)}
            for what, one in (("gaussian", whole), ("even", even))
        }
    return found


def pooled(presets: Sequence[str], kind: str) -> dict[str, Any]:
    """What the picture shows of a stimulus: quartiles of what was reported, and spread, over time by parameter."""
    told = np.concatenate([course(preset, kind).reported for preset in presets])  # (runs, times, 3)
    spread = np.exp(np.mean([np.log(course(preset, kind).spread) for preset in presets], axis=0))
    return {"told": rounded(np.quantile(told, [0.25, 0.5, 0.75], axis=0)), "spread": rounded(spread)}


@drawing
def draw(found: dict[str, Any]) -> None:
    """Uncertainty against time for the line, against load for the curves."""
    figure = new_figure(9.2, 5.6)
    axes = figure.subplots(2, 3)
    for parameter, axis in enumerate(axes[0]):
        for kind, colour, dash, label in (
            ("gaussian", ORANGE, DASHES[1], "Gaussian, 0.5 to 10.5 N"),
            ("designed", BLUE, DASHES[0], "designed"),
        ):
            low, middle, high = 100.0 * np.array(found["pooled"][kind]["told"])[:, :, parameter]
            spread = 100.0 * np.array(found["pooled"][kind]["spread"])[:, parameter]
            axis.fill_between(TIMES, low, high, color=colour, alpha=0.2, linewidth=0.0)
            axis.plot(TIMES, middle, color=colour, linestyle=dash, label=f"{label}: reported")
            axis.plot(TIMES, spread, "o", color=colour, markersize=2.6, label=f"{label}: spread")
            if kind == "gaussian":
                axis.axhline(middle[-1], color=MUTED, linewidth=0.8, linestyle=":")
        _times_axis(axis)
        axis.set_ylim(0.25, 40.0)
        _finish(axis, (0.5, 1.0, 2.0, 5.0, 10.0, 20.0), f"{PARAMETERS[parameter].capitalize()} about 5.5 N, six sites")
    curves_of = found["presets"][DEFAULT_PRESET]["curves"]
    for parameter, axis in enumerate(axes[1]):
        for kind, colour, dash, label in (
            ("gaussian", ORANGE, DASHES[1], "Gaussian, 4 s"),
            ("even", GREEN, DASHES[2], "even, 2 s"),
        ):
            told, spread = (100.0 * np.array(curves_of[kind][measure])[parameter] for measure in ("told", "spread"))
            axis.plot(LOADS_N, told, color=colour, linestyle=dash, label=f"{label}: reported")
            axis.plot(LOADS_N, spread, "o", color=colour, markersize=3.0, label=f"{label}: spread")
        axis.set_yscale("log")
        axis.set_ylim(0.1, 12.0)
        axis.set_xticks(LOADS_N)
        axis.set_xlabel("Load (N)")
        _finish(
            axis, (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0), f"{PARAMETERS[parameter].capitalize()} over depth, one site"
        )
    for row in axes:
        row[0].set_ylabel("Standard deviation (%)")
        row[2].legend(loc="upper right", fontsize=7.0)
    plain_image(figure, PICTURE, "png", dots_per_inch=110.0)


def _times_axis(axis: Axes) -> None:
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xticks([0.5, 1.0, 2.0, 4.0], ["0.5", "1", "2", "4"])
    axis.set_xticks([], minor=True)
    axis.set_xlabel("Length after the preload (s)")


def _finish(axis: Axes, ticks: Sequence[float], title: str) -> None:
    axis.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.set_yticks([], minor=True)
    axis.set_title(title)


def print_costs() -> None:
    """Edges and heating of the stimuli."""
    for kind in STIMULI:
        found = appraised(kind)
        print(
            f"{kind:9} {found.force_min_n:.1f} to {found.force_max_n:.1f} N, {found.force_std_n:.2f} N rms about it; "
            f"steepest edge {found.steepest_edge_n_per_ms:.2f} N/ms; coil warmer by {found.heating.expected_k:.2f} K"
        )


def print_variants() -> None:
    """What each step from the reference to the designed stimulus does, after half its length."""
    for name, variant in variants().items():
        found = after_half(DEFAULT_PRESET, variant)
        shown = "; ".join(f"{measure} {percents(getattr(found, measure)[0])}" for measure in MEASURES)
        print(f"  {name:40} {shown}", flush=True)


def main() -> None:
    """Measure, print, and with ``--write`` draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="make the picture and its data")
    parser.add_argument("--preset", choices=SKIN, action="append", help="only this preset")
    parser.add_argument("--ablation", action="store_true", help="what makes the difference, on one preset, instead")
    options = parser.parse_args()
    if options.ablation:
        print_variants()
        return
    presets = options.preset or SKIN
    if options.write and presets != SKIN:
        raise UnusableInputError("the picture needs all presets: leave out --preset")
    print_costs()
    found = report(presets)
    if options.write:
        draw(found)
        PICTURE.with_suffix(".json").write_text(json.dumps(found) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
