"""Recipes of chapters 4 and 5 that are not overlays of several tests: kernels, filters, partitions, validation."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from tissueid.analysis.curves.depth import profile_plots
from tissueid.analysis.curves.kernels import (
    contribution_plots,
    impulse_contribution_plot,
    kernel_and_spectrum,
    kernel_curves,
    partition_plots,
    second_order_kernel,
)
from tissueid.analysis.curves.linear import first_kernel_plot
from tissueid.analysis.curves.plot import Curve, Plot
from tissueid.analysis.curves.validation import held_out_prediction, prediction_plots
from tissueid.analysis.overlay import Overlay
from tissueid.formatting import fixed, grouped
from tissueid.identification.base import Array
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.engines.partitions import Depth
from tissueid.identification.engines.volterra import Volterra
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.identification.volterra.prior import roughness
from tissueid.identification.volterra.structure import VolterraModel
from tissueid.language import marked
from tissueid.records import Record
from tissueid.reports.overlay_page import DrawnFigures
from tissueid_lab.thesis.comparisons import EXACT, LAGS_3, POSTERIOR, SITES
from tissueid_lab.thesis.recipe import (
    NumberRow,
    Outcome,
    RecipeSource,
    Recording,
    ThesisFigure,
    drawn_grid,
    fitted,
    percent,
)
from tissueid_lab.thesis.simulated_systems import LAGS, RATE_HZ, DpnSystem, WienerSystem, simulated_cascade

LARGE = Recording(f"{POSTERIOR}-large", POSTERIOR)
"""The test of chapters 4 and 5: uniform force with a cutoff of 200 Hz, into the skin and off it."""
_ONE = (RecipeSource(SITES[POSTERIOR], LARGE),)
_RAW = f"raw={EXACT},{LAGS_3}"
_FILTERED = f"filtered={EXACT},{LAGS_3},smoothing=1"
_FIFTEEN = "depth,partitions=15,correct=false,memory=0.08,downsample=1"
_SECONDS = 8.0
"""Length of the records of Figs. 5.1 and 5.3, s."""


# -- kernels of simulated systems -------------------------------------------------------------------------------------


def _alike(first: Array, second: Array) -> str:
    """Return the cosine between two arrays of one shape."""
    return fixed(float(np.sum(first * second) / np.linalg.norm(first) / np.linalg.norm(second)), 3)


def _cascade_kernels(curve: Literal["exponential", "square"]) -> Outcome:
    """Return kernels of a Wiener and a Hammerstein system with one curve (Figs. 4.3 and 4.4)."""
    square = curve == "square"
    drawn, rows = DrawnFigures((), ()), []
    alt = marked("Response by order, measured against modelled output, and second-order kernel over two lags.")
    for structure, heading in (
        ("Wiener", marked("Kernels of a Wiener system")),
        ("Hammerstein", marked("Kernels of a Hammerstein system")),
    ):
        record, h = simulated_cascade(structure, curve)
        model = Volterra(memory=LAGS / RATE_HZ, downsample=1, method="exact").fit(record)
        first, second = _kernels_of(model)
        _, linear, bent = model.contributions(record.input)
        share = 100.0 * float(np.var(linear) / np.var(linear + bent))
        diagonal = 100.0 * float(np.sum(np.diag(second) ** 2) / np.sum(second**2))
        vaf_row = NumberRow(
            f"{structure}, VAF",
            marked("perfect") if square else marked("not given"),
            f"{fixed(model.report.vaf_percent, 2)} %",
        )
        first_row = (
            NumberRow(
                f"{structure}, share of the first kernel", marked("the linear part vanishes"), f"{fixed(share, 2)} %"
            )
            if square
            else NumberRow(
                f"{structure}, first kernel and linear stage, cosine", marked("as the linear stage"), _alike(first, h)
            )
        )
        product = np.outer(h, h) if square else -np.outer(h, h)
        second_row = (
            NumberRow("Wiener, second kernel, cosine", marked("the product of two responses"), _alike(second, product))
            if structure == "Wiener"
            else NumberRow(
                "Hammerstein, second kernel on the diagonal",
                marked("on the diagonal alone"),
                f"{fixed(diagonal, 1)} %",
            )
        )
        rows += [vaf_row, first_row, second_row]
        plots = (
            impulse_contribution_plot(model, record, float(np.std(record.input))),
            contribution_plots(model, record, slice(None))[-1],
            second_order_kernel(model, record),
        )
        more = drawn_grid(structure.lower(), heading, alt, [plots])
        drawn = DrawnFigures(drawn.pictures + more.pictures, drawn.plots + more.plots)
    return drawn, rows


def _kernels_of(model: VolterraModel) -> tuple[Array, Array]:
    assert model.kernel1 is not None
    assert model.kernel2 is not None
    return model.kernel1, model.kernel2


# -- kernels of skin --------------------------------------------------------------------------------------------------

_ROUGH = marked("share of the second kernel above a quarter of the sampling rate")


def _kernels(overlay: Overlay) -> Outcome:
    model, record, _part = fitted(overlay, VolterraModel, "raw")
    report = model.report
    rows = report.n_samples // model.lag_spacing
    per_row = (float(report.aic or np.nan) - 2.0 * report.n_parameters) / report.n_samples + float(np.log(1e6))
    return drawn_grid(
        "kernels",
        marked("First- and second-order kernel"),
        marked("First-order kernel against lag, and second-order kernel over two lags."),
        [(first_kernel_plot(model, record), second_order_kernel(model, record))],
        row_height=3.4,
    ), [
        NumberRow(marked("VAF"), marked("96 % or better"), percent(report.vaf_percent)),
        NumberRow(
            marked("parameters, and rows that they are fitted to"),
            marked("903 from about 2700"),
            f"{grouped(report.n_parameters)} from {grouped(rows)}",
        ),
        NumberRow(marked("AIC, positions in mm"), "1171", grouped(round(2.0 * report.n_parameters + rows * per_row))),
        NumberRow(_ROUGH, marked("no discernible pattern"), f"{fixed(100.0 * roughness(_kernels_of(model)[1]), 1)} %"),
    ]


def _in_time(overlay: Overlay) -> Outcome:
    runs = [held_out_prediction(entry.fit.label, entry.analysis) for entry in overlay.entries]
    return drawn_grid(
        "prediction",
        marked("Measured and modelled position"),
        marked("Position over a stretch of the test, measured and modelled, and the residuals."),
        [[plot] for plot in prediction_plots(runs)],
        row_height=2.4,
        over=True,
    ), []


def _spectra(overlay: Overlay) -> Outcome:
    raw, smooth = (fitted(overlay, VolterraModel, fit) for fit in ("raw", "filtered"))
    rough = [fixed(100.0 * roughness(_kernels_of(analysed[0])[1]), 1) for analysed in (raw, smooth)]
    return drawn_grid(
        "kernel-spectra",
        marked("Second-order kernel and its spectrum, before and after the filter"),
        marked("Second-order kernel over two lags, and the magnitude of its two-dimensional Fourier transform."),
        [kernel_and_spectrum("raw", *raw[:2]), kernel_and_spectrum("filtered", *smooth[:2])],
        row_height=3.2,
    ), [
        NumberRow(marked("VAF before the filter"), "94.7 %", percent(raw[0].report.vaf_percent)),
        NumberRow(marked("VAF after the filter"), "90.4 %", percent(smooth[0].report.vaf_percent)),
        NumberRow(_ROUGH, marked("large, then removed"), f"{rough[0]} % and {rough[1]} %"),
    ]


def _contributions(overlay: Overlay) -> Outcome:
    plots, rows = [], []
    for fit, said in (("raw", marked("noise")), ("filtered", marked("almost none"))):
        model, record, part = fitted(overlay, VolterraModel, fit)
        plots.append(contribution_plots(model, record, part))
        _, first, second = model.contributions(record.input)
        diagonal = replace(model, kernel2=np.diag(np.diag(_kernels_of(model)[1])), kernel3=None, order=2)
        alone = diagonal.contributions(record.input)[2]
        shares = [
            100.0 * float(np.nanstd(contribution[part]) / np.nanstd(first[part])) for contribution in (alone, second)
        ]
        what = f"{fit}: diagonal of the second kernel, and all of it, relative to the first"
        rows.append(NumberRow(what, said, f"{fixed(shares[0], 0)} % and {fixed(shares[1], 0)} %"))
    alt = marked("Three panels for each model: first order, diagonal of the second order, all of it.")
    heading = marked("Measured against modelled position as orders are added")
    return drawn_grid("contributions", heading, alt, plots, row_height=3.2), rows


# -- partitions -------------------------------------------------------------------------------------------------------


def _validated(name: str, quick: bool) -> Outcome:
    """Return what partitions find of a known system under two inputs (Figs. 5.1 and 5.3)."""
    system = WienerSystem() if name == "Wiener" else DpnSystem()
    random = np.random.Generator(np.random.PCG64(3))
    count, warm = round((0.5 if quick else 1.0) * _SECONDS * RATE_HZ), 200
    gaussian = 2.5 + 1.2 * random.standard_normal(count + warm)
    levels = np.repeat(random.permutation(np.tile((0.5, 1.5, 2.5, 3.5, 4.5), 4)), -(-(count + warm) // 20))
    stepped = levels[: count + warm] + 0.5 * random.standard_normal(count + warm)
    # The correction takes most of the time.
    engine = Depth(memory=0.12, partitions=7, downsample=1, hold="zero-order", correct=not quick)
    scales = {"mass": 1e3, "damping": 1.0, "stiffness": 1.0}
    profiles: dict[str, DepthProfile] = {}
    rows = []
    for label, force in ((marked("steps and noise"), stepped), (marked("Gaussian noise"), gaussian)):
        position = system.position(force, RATE_HZ)
        profile = engine.fit(Record(force[warm:], position[warm:], RATE_HZ)).depth_profile()
        assert profile is not None
        profiles[label] = profile
        errors = [
            100.0 * float(np.nanmedian(np.abs(getattr(profile, what) / getattr(system, what)(profile.position) - 1.0)))
            for what in scales
        ]
        shown = ", ".join(fixed(item, 1) for item in errors)
        rows.append(NumberRow(f"{label}: median error of M, B, K", marked("match the trend"), f"{shown} %"))
    low = min(float(item.position[0]) for item in profiles.values())
    high = max(float(item.position[-1]) for item in profiles.values())
    fine = np.linspace(low, high, 100)
    with_truth = [
        _with_truth(plot, fine, scale * getattr(system, what)(fine))
        for plot, (what, scale) in zip(profile_plots(profiles)[:3], scales.items(), strict=True)
    ]
    return drawn_grid(
        "validation",
        marked("Mass, damping and stiffness by depth, and those of the system"),
        marked("Three panels against position: estimates with two inputs, and the true curve."),
        [with_truth],
        row_height=3.4,
        over=True,
    ), rows


def _with_truth(plot: Plot, position: Array, values: Array) -> Plot:
    truth = Curve(1e3 * position, values, marked("system"), "text", "line", width=1.0)
    limits = plot.y.limits
    if limits is not None:
        limits = min(limits[0], 0.9 * float(values.min())), max(limits[1], 1.1 * float(values.max()))
    return replace(plot, y=replace(plot.y, limits=limits), parts=(*plot.parts, truth))


def _partitioned(overlay: Overlay) -> Outcome:
    model, record, part = fitted(overlay, PartitionedModel)
    limits, kernels = 1e3 * model.breakpoints_m, model.operating_kernels
    widths = np.diff(limits)
    dips = [100.0 * float(-kernel[2:].min() / kernel.max()) for kernel in (kernels[0], kernels[-1])]
    return drawn_grid(
        "partitions",
        marked("Output with its partitions, and kernels by depth"),
        marked("Position over time with the limits of the partitions, samples in each, and the kernels of all depths."),
        [partition_plots(model, record, part), kernel_curves(model, record)],
        row_height=3.2,
    ), [
        NumberRow(
            marked("widest partitions"),
            marked("the shallowest and the deepest"),
            f"{fixed(float(widths[0]), 2)} and {fixed(float(widths[-1]), 2)} mm; "
            f"{fixed(float(np.median(widths)), 2)} mm (median)",
        ),
        NumberRow(
            marked("negative peak, shallowest and deepest kernel"),
            marked("pronounced when shallow, heavily damped when deep"),
            f"{fixed(dips[0], 0)} and {fixed(dips[1], 0)} % of the peak",
        ),
    ]


def _fifteen_rows(overlay: Overlay) -> list[NumberRow]:
    return [NumberRow(marked("parameters"), "600", grouped(fitted(overlay, PartitionedModel)[0].report.n_parameters))]


KERNEL_FIGURES: tuple[ThesisFigure, ...] = (
    ThesisFigure(
        "4.3",
        marked("Kernels of Wiener and Hammerstein systems with an exponential"),
        study=lambda _quick: _cascade_kernels("exponential"),
    ),
    ThesisFigure(
        "4.4",
        marked("Kernels of Wiener and Hammerstein systems with a square"),
        study=lambda _quick: _cascade_kernels("square"),
    ),
    ThesisFigure("4.6", marked("Kernels of skin at 667 Hz"), _ONE, (_RAW,), drawn=_kernels),
    ThesisFigure(
        "4.7",
        marked("Measured position and that of the second-order model"),
        _ONE,
        (_RAW,),
        drawn=_in_time,
        vafs=((marked("VAF"), marked("96 % or better"), "", "raw"),),
    ),
    ThesisFigure(
        "4.9",
        marked("Second-order kernel and its spectrum, before and after the filter"),
        _ONE,
        (_RAW, _FILTERED),
        drawn=_spectra,
    ),
    ThesisFigure(
        "4.10",
        marked("Residual nonlinearity before and after the filter"),
        _ONE,
        (_RAW, _FILTERED),
        drawn=_contributions,
    ),
    ThesisFigure(
        "4.11",
        marked("Filtered and unfiltered model in time"),
        _ONE,
        (_RAW, _FILTERED),
        drawn=_in_time,
        vafs=(
            (marked("VAF, unfiltered"), marked("about 96 %"), "", "raw"),
            (marked("VAF, filtered"), marked("about 93.7 %"), "", "filtered"),
        ),
    ),
    ThesisFigure(
        "5.1", marked("Depth partitions of a known Wiener system"), study=lambda quick: _validated("Wiener", quick)
    ),
    ThesisFigure("5.3", marked("Depth partitions of a known DPN system"), study=lambda quick: _validated("DPN", quick)),
    ThesisFigure(
        "5.4",
        marked("Partitions of a record, and kernels by depth"),
        _ONE,
        (_FIFTEEN,),
        downsample=4,
        drawn=_partitioned,
    ),
    ThesisFigure(
        "5.5",
        marked("Fifteen depth partitions of skin"),
        _ONE,
        (_FIFTEEN,),
        ("partitions",),
        _fifteen_rows,
        downsample=4,
        vafs=((marked("VAF, 15 partitions, scheduled"), "92.2 %", "", ""),),
    ),
)
"""Figures of chapters 4 and 5 from one test or from simulated records."""
