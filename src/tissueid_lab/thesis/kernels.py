"""Recipes of chapters 4 and 5 that are not overlays of several tests: kernels, filters, partitions, validation."""

from __future__ import annotations

from dataclasses import replace

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
from tissueid.identification.volterra.model import VolterraModel
from tissueid.identification.volterra.prior import roughness
from tissueid.language import marked
from tissueid.records import Record
from tissueid.reports.overlay import DrawnFigures
from tissueid_lab.thesis.comparisons import EXACT, LAGS_3, POSTERIOR, SITES, entry_of, percent
from tissueid_lab.thesis.page import PlotGrid, Row, drawn_grids
from tissueid_lab.thesis.recipe import Outcome, Recording, Source, ThesisFigure
from tissueid_lab.thesis.simulated_systems import LAGS, RATE_HZ, DpnSystem, WienerSystem, simulated_cascade

LARGE = Recording(f"{POSTERIOR}-large", POSTERIOR)
"""The test of chapters 4 and 5: uniform force with a cutoff of 200 Hz, into the skin and off it."""
_ONE = (Source(SITES[POSTERIOR], LARGE),)
_RAW = f"raw={EXACT},{LAGS_3}"
_FILTERED = f"filtered={EXACT},{LAGS_3},smoothing=1"
_FIFTEEN = "depth,partitions=15,correct=false,memory=0.08,downsample=1"
_SECONDS = 8.0
"""Length of the records of Figs. 5.1 and 5.3, s."""


def _volterra(found: Overlay, fit: str) -> tuple[VolterraModel, Record, slice]:
    analysis = entry_of(found, fit=fit).analysis
    assert isinstance(analysis.model, VolterraModel)
    return analysis.model, analysis.record, analysis.fit_part


# -- kernels of simulated systems -------------------------------------------------------------------------------------


def _alike(one: Array, other: Array) -> str:
    """Return the cosine between two arrays of one shape."""
    return fixed(float(np.sum(one * other) / np.linalg.norm(one) / np.linalg.norm(other)), 3)


def _cascade_kernels(curve: str) -> Outcome:
    """Return kernels of a Wiener and a Hammerstein system with one curve (Figs. 4.3 and 4.4)."""
    grids, rows = [], []
    for structure in ("Wiener", "Hammerstein"):
        system = simulated_cascade(structure, "square" if curve == "square" else "exponential")
        model = Volterra(memory=LAGS / RATE_HZ, downsample=1, method="exact").fit(system.record)
        assert model.kernel1 is not None
        assert model.kernel2 is not None
        h = system.impulse_response
        _, first, second = model.contributions(system.record.input)
        linear = 100.0 * float(np.var(first) / np.var(first + second))
        diagonal = 100.0 * float(np.sum(np.diag(model.kernel2) ** 2) / np.sum(model.kernel2**2))
        vaf = marked("perfect") if curve == "square" else marked("not given")
        rows.append(Row(f"{structure}, VAF", vaf, f"{fixed(model.report.vaf_percent, 2)} %"))
        if curve == "square":
            share = marked("the linear part vanishes")
            rows.append(Row(f"{structure}, share of the first kernel", share, f"{fixed(linear, 2)} %"))
        else:
            same = marked("as the linear stage")
            rows.append(Row(f"{structure}, first kernel and linear stage, cosine", same, _alike(model.kernel1, h)))
        if structure == "Wiener":
            product = np.outer(h, h) if curve == "square" else -np.outer(h, h)
            said = marked("the product of two responses")
            rows.append(Row("Wiener, second kernel, cosine", said, _alike(model.kernel2, product)))
        else:
            said = marked("on the diagonal alone")
            rows.append(Row("Hammerstein, second kernel on the diagonal", said, f"{fixed(diagonal, 1)} %"))
        plots = (
            impulse_contribution_plot(model, system.record, float(np.std(system.record.input))),
            contribution_plots(model, system.record, slice(None))[-1],
            second_order_kernel(model, system.record),
        )
        heading = (
            marked("Kernels of a Wiener system") if structure == "Wiener" else marked("Kernels of a Hammerstein system")
        )
        alt = marked("Response by order, measured against modelled output, and second-order kernel over two lags.")
        grids.append(PlotGrid(structure.lower(), heading, alt, [plots], row_height=3.0, over=False))
    return drawn_grids(grids), rows


# -- kernels of skin --------------------------------------------------------------------------------------------------


def _kernel_rows(found: Overlay) -> list[Row]:
    model, _, _ = _volterra(found, "raw")
    report = model.report
    assert model.kernel2 is not None
    rows = report.n_samples // model.lag_spacing
    per_row = (float(report.aic or np.nan) - 2.0 * report.n_parameters) / report.n_samples + float(np.log(1e6))
    aic_mm = 2.0 * report.n_parameters + rows * per_row
    return [
        Row(marked("VAF"), marked("96 % or better"), percent(report.vaf_percent)),
        Row(
            marked("parameters, and rows that they are fitted to"),
            marked("903 from about 2700"),
            f"{grouped(report.n_parameters)} from {grouped(rows)}",
        ),
        Row(marked("AIC, positions in mm"), "1171", grouped(round(aic_mm))),
        Row(
            marked("share of the second kernel above a quarter of the sampling rate"),
            marked("no discernible pattern"),
            f"{fixed(100.0 * roughness(model.kernel2), 1)} %",
        ),
    ]


def _kernels(found: Overlay) -> DrawnFigures:
    model, record, _ = _volterra(found, "raw")
    heading = marked("First- and second-order kernel")
    alt = marked("First-order kernel against lag, and second-order kernel over two lags.")
    plots = (first_kernel_plot(model, record), second_order_kernel(model, record))
    return drawn_grids([PlotGrid("kernels", heading, alt, [plots], row_height=3.4, over=False)])


def _in_time(found: Overlay, *fits: str) -> DrawnFigures:
    runs = [held_out_prediction(fit, entry_of(found, fit=fit).analysis) for fit in fits]
    heading = marked("Measured and modelled position")
    alt = marked("Position over a stretch of the test, measured and modelled, and the residuals.")
    return drawn_grids([PlotGrid("prediction", heading, alt, [[p] for p in prediction_plots(runs)], row_height=2.4)])


def _in_time_rows(found: Overlay) -> list[Row]:
    return [Row(marked("VAF"), marked("96 % or better"), percent(entry_of(found, fit="raw").shown_percent))]


def _spectra(found: Overlay) -> DrawnFigures:
    rows = [kernel_and_spectrum(fit, *_volterra(found, fit)[:2]) for fit in ("raw", "filtered")]
    heading = marked("Second-order kernel and its spectrum, before and after the filter")
    alt = marked("Second-order kernel over two lags, and the magnitude of its two-dimensional Fourier transform.")
    return drawn_grids([PlotGrid("kernel-spectra", heading, alt, rows, row_height=3.2, over=False)])


def _filter_rows(found: Overlay) -> list[Row]:
    (raw, _, _), (smooth, _, _) = (_volterra(found, fit) for fit in ("raw", "filtered"))
    assert raw.kernel2 is not None
    assert smooth.kernel2 is not None
    rough = [fixed(100.0 * roughness(one), 1) for one in (raw.kernel2, smooth.kernel2)]
    return [
        Row(marked("VAF before the filter"), "94.7 %", percent(raw.report.vaf_percent)),
        Row(marked("VAF after the filter"), "90.4 %", percent(smooth.report.vaf_percent)),
        Row(
            marked("share of the second kernel above a quarter of the sampling rate"),
            marked("large, then removed"),
            f"{rough[0]} % and {rough[1]} %",
        ),
    ]


def _contributions(found: Overlay) -> DrawnFigures:
    heading = marked("Measured against modelled position as orders are added")
    alt = marked("Three panels for each model: first order, diagonal of the second order, all of it.")
    rows = [contribution_plots(*_volterra(found, fit)) for fit in ("raw", "filtered")]
    return drawn_grids([PlotGrid("contributions", heading, alt, rows, row_height=3.2, over=False)])


def _contribution_rows(found: Overlay) -> list[Row]:
    rows = []
    for fit, said in (("raw", marked("noise")), ("filtered", marked("almost none"))):
        model, record, part = _volterra(found, fit)
        _, first, second = model.contributions(record.input)
        assert model.kernel2 is not None
        diagonal = replace(model, kernel2=np.diag(np.diag(model.kernel2)), kernel3=None, order=2)
        alone = diagonal.contributions(record.input)[2]
        known = slice(part.start, part.stop)
        shares = [100.0 * float(np.nanstd(one[known]) / np.nanstd(first[known])) for one in (alone, second)]
        what = f"{fit}: diagonal of the second kernel, and all of it, relative to the first"
        rows.append(Row(what, said, f"{fixed(shares[0], 0)} % and {fixed(shares[1], 0)} %"))
    return rows


def _filtered_rows(found: Overlay) -> list[Row]:
    return [
        Row(marked("VAF, unfiltered"), marked("about 96 %"), percent(entry_of(found, fit="raw").shown_percent)),
        Row(marked("VAF, filtered"), marked("about 93.7 %"), percent(entry_of(found, fit="filtered").shown_percent)),
    ]


# -- partitions -------------------------------------------------------------------------------------------------------


def _validated(name: str, quick: bool) -> Outcome:
    """Return what partitions find of a known system under two inputs (Figs. 5.1 and 5.3)."""
    system = WienerSystem() if name == "Wiener" else DpnSystem()
    random = np.random.Generator(np.random.PCG64(3))
    count, warm = round((0.5 if quick else 1.0) * _SECONDS * RATE_HZ), 200
    gaussian = 2.5 + 1.2 * random.standard_normal(count + warm)
    levels = np.repeat(random.permutation(np.tile((0.5, 1.5, 2.5, 3.5, 4.5), 4)), -(-(count + warm) // 20))
    stepped = levels[: count + warm] + 0.5 * random.standard_normal(count + warm)
    profiles: dict[str, DepthProfile] = {}
    rows = []
    for label, force, said in (
        (marked("steps and noise"), stepped, marked("match the trend")),
        (marked("Gaussian noise"), gaussian, marked("match the trend")),
    ):
        position = system.position(force, RATE_HZ)
        record = Record(force[warm:], position[warm:], RATE_HZ)
        profile = (
            Depth(
                memory=0.12,
                partitions=7,
                downsample=1,
                hold="zero-order",
                correct=not quick,  # takes most of the time
            )
            .fit(record)
            .depth_profile()
        )
        assert profile is not None
        profiles[label] = profile
        errors = [
            100.0 * float(np.nanmedian(np.abs(getattr(profile, what) / getattr(system, what)(profile.position) - 1.0)))
            for what in ("mass", "damping", "stiffness")
        ]
        rows.append(Row(f"{label}: median error of M, B, K", said, f"{', '.join(fixed(one, 1) for one in errors)} %"))
    plots = list(profile_plots(profiles))[:3]
    low = min(float(one.position[0]) for one in profiles.values())
    high = max(float(one.position[-1]) for one in profiles.values())
    fine = np.linspace(low, high, 100)
    scales = {"mass": 1e3, "damping": 1.0, "stiffness": 1.0}
    with_truth = [
        _with_truth(plot, fine, scale * getattr(system, what)(fine))
        for plot, (what, scale) in zip(plots, scales.items(), strict=True)
    ]
    heading = marked("Mass, damping and stiffness by depth, and those of the system")
    alt = marked("Three panels against position: estimates with two inputs, and the true curve.")
    return drawn_grids([PlotGrid("validation", heading, alt, [with_truth], row_height=3.4)]), rows


def _with_truth(plot: Plot, position: Array, values: Array) -> Plot:
    truth = Curve(1e3 * position, values, marked("system"), "text", "line", width=1.0)
    limits = plot.y.limits
    if limits is not None:
        limits = min(limits[0], 0.9 * float(values.min())), max(limits[1], 1.1 * float(values.max()))
    return replace(plot, y=replace(plot.y, limits=limits), parts=(*plot.parts, truth))


def _partitioned(found: Overlay) -> DrawnFigures:
    analysis = entry_of(found).analysis
    assert isinstance(analysis.model, PartitionedModel)
    rows = [partition_plots(analysis.model, analysis.record, analysis.fit_part)]
    rows.append(kernel_curves(analysis.model, analysis.record))
    heading = marked("Output with its partitions, and kernels by depth")
    alt = marked(
        "Position over time with the limits of the partitions, samples in each, and the kernels of all depths."
    )
    return drawn_grids([PlotGrid("partitions", heading, alt, rows, row_height=3.2, over=False)])


def _partitioned_rows(found: Overlay) -> list[Row]:
    model = entry_of(found).analysis.model
    assert isinstance(model, PartitionedModel)
    limits, kernels = 1e3 * model.breakpoints_m, model.operating_kernels
    widths = np.diff(limits)
    dips = [100.0 * float(-one[2:].min() / one.max()) for one in (kernels[0], kernels[-1])]
    return [
        Row(
            marked("widest partitions"),
            marked("the shallowest and the deepest"),
            f"{fixed(float(widths[0]), 2)} and {fixed(float(widths[-1]), 2)} mm; "
            f"{fixed(float(np.median(widths)), 2)} mm (median)",
        ),
        Row(
            marked("negative peak, shallowest and deepest kernel"),
            marked("pronounced when shallow, heavily damped when deep"),
            f"{fixed(dips[0], 0)} and {fixed(dips[1], 0)} % of the peak",
        ),
    ]


def _fifteen_rows(found: Overlay) -> list[Row]:
    entry = entry_of(found)
    return [
        Row(marked("VAF, 15 partitions, scheduled"), "92.2 %", percent(entry.shown_percent)),
        Row(marked("parameters"), "600", grouped(entry.analysis.model.report.n_parameters)),
    ]


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
    ThesisFigure("4.6", marked("Kernels of skin at 667 Hz"), _ONE, (_RAW,), (), _kernel_rows, drawn=_kernels),
    ThesisFigure(
        "4.7",
        marked("Measured position and that of the second-order model"),
        _ONE,
        (_RAW,),
        (),
        _in_time_rows,
        drawn=lambda found: _in_time(found, "raw"),
    ),
    ThesisFigure(
        "4.9",
        marked("Second-order kernel and its spectrum, before and after the filter"),
        _ONE,
        (_RAW, _FILTERED),
        (),
        _filter_rows,
        drawn=_spectra,
    ),
    ThesisFigure(
        "4.10",
        marked("Residual nonlinearity before and after the filter"),
        _ONE,
        (_RAW, _FILTERED),
        (),
        _contribution_rows,
        drawn=_contributions,
    ),
    ThesisFigure(
        "4.11",
        marked("Filtered and unfiltered model in time"),
        _ONE,
        (_RAW, _FILTERED),
        (),
        _filtered_rows,
        drawn=lambda found: _in_time(found, "raw", "filtered"),
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
        (),
        _partitioned_rows,
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
    ),
)
"""Figures of chapters 4 and 5 from one test or from simulated records."""

__all__ = ["KERNEL_FIGURES", "LARGE"]
