"""What the plots of results are called: panels, their axes and bands, and the pictures that they make up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tissueid.app.views.researcher.drawn import Panel
from tissueid.language import marked

KERNELS = marked("Kernel image")


@dataclass(frozen=True)
class Look:
    """A panel: what it is called, its axis, which axes are logarithmic, and what its band means."""

    title: str
    x_label: str
    logs: tuple[str, ...] = ()
    band: str = ""


PANELS: dict[Panel, Look] = {
    "output": Look(marked("Measured and simulated output, held out"), ""),
    "residual": Look(marked("Measured less simulated"), marked("Time from the start of the record (s)")),
    "impulse": Look(
        marked("Impulse response about the mean input"),
        marked("Lag (ms)"),
        band=marked("Band: one standard deviation to either side, where the engine tells it"),
    ),
    "magnitude": Look(
        marked("Magnitude"), "", ("bottom", "left"), marked("Band: 95 % confidence, where it was measured")
    ),
    "phase": Look(marked("Phase"), "", ("bottom",), marked("Band: 95 % confidence, where it was measured")),
    "coherence": Look(marked("Coherence of the record"), marked("Frequency (Hz)"), ("bottom",)),
    "nonlinearity": Look(
        marked("Static nonlinearity"),
        marked("Input of the curve (N, or what the input is measured in)"),
        band=marked(
            "Band: Wiener, the standard deviation of what was measured about the curve; Hammerstein, 95 % confidence"
        ),
    ),
    "mass": Look(marked("Mass"), "", band=marked("Band: one standard deviation to either side")),
    "damping": Look(marked("Damping"), "", band=marked("Band: one standard deviation to either side")),
    "stiffness": Look(
        marked("Stiffness"), marked("Position (mm)"), band=marked("Band: one standard deviation to either side")
    ),
    "autocorrelation": Look(
        marked("Autocorrelation of the held-out residual"),
        marked("Lag (ms)"),
        band=marked(
            "Band: what one lag exceeds one time in twenty, 1.96 over the root of the samples for a white residual"
        ),
    ),
    "cross": Look(
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

__all__ = ["KERNELS", "OUTPUT", "PANELS", "PICTURES", "Look"]
