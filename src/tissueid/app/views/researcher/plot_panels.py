"""Titles, axes and bands of the panels, and the pictures that are made of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tissueid.app.views.researcher.plot_data import Panel
from tissueid.language import marked

KERNELS = marked("Kernel image")


@dataclass(frozen=True)
class PanelStyle:
    """Title, x axis, logarithmic axes and meaning of the band of a panel."""

    title: str
    x_label: str
    logs: tuple[str, ...] = ()
    band: str = ""


PANELS: dict[Panel, PanelStyle] = {
    "output": PanelStyle(marked("Measured and simulated output, held out"), ""),
    "residual": PanelStyle(marked("Measured less simulated"), marked("Time from the start of the record (s)")),
    "impulse": PanelStyle(
        marked("Impulse response about the mean input"),
        marked("Lag (ms)"),
        band=marked("Band: ± one standard deviation, if the engine estimates it"),
    ),
    "magnitude": PanelStyle(
        marked("Magnitude"), "", ("bottom", "left"), marked("Band: 95 % confidence, where it was measured")
    ),
    "phase": PanelStyle(marked("Phase"), "", ("bottom",), marked("Band: 95 % confidence, where it was measured")),
    "coherence": PanelStyle(marked("Coherence of the record"), marked("Frequency (Hz)"), ("bottom",)),
    "nonlinearity": PanelStyle(
        marked("Static nonlinearity"),
        marked("Input of the curve (N, or what the input is measured in)"),
        band=marked(
            "Band: Wiener, the standard deviation of what was measured about the curve; Hammerstein, 95 % confidence"
        ),
    ),
    "mass": PanelStyle(marked("Mass"), "", band=marked("Band: ± one standard deviation")),
    "damping": PanelStyle(marked("Damping"), "", band=marked("Band: ± one standard deviation")),
    "stiffness": PanelStyle(
        marked("Stiffness"), marked("Position (mm)"), band=marked("Band: ± one standard deviation")
    ),
    "autocorrelation": PanelStyle(
        marked("Autocorrelation of the held-out residual"),
        marked("Lag (ms)"),
        band=marked(
            "Band: what one lag exceeds one time in twenty, 1.96 over the root of the samples for a white residual"
        ),
    ),
    "cross": PanelStyle(
        marked("Input against the held-out residual"),
        marked("Lag (ms)"),
        band=marked("Band: what one lag exceeds one time in twenty if the residual is unrelated to the input"),
    ),
}

OUTPUT = marked("Model output")
PICTURES: Mapping[str, tuple[Panel, ...]] = {
    OUTPUT: ("output", "residual"),
    marked("Impulse response"): ("impulse",),
    marked("Bode diagram"): ("magnitude", "phase", "coherence"),
    marked("Static nonlinearity"): ("nonlinearity",),
    marked("Against depth"): ("mass", "damping", "stiffness"),
    marked("Residual tests"): ("autocorrelation", "cross"),
    KERNELS: (),
}

__all__ = ["KERNELS", "OUTPUT", "PANELS", "PICTURES", "PanelStyle"]
