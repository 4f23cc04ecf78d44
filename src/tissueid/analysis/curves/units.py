"""Axes of signals, and display units of ratios and kernels."""

from __future__ import annotations

from tissueid.analysis.curves.plot import Axis
from tissueid.formatting import label_and_unit, superscript
from tissueid.language import marked
from tissueid.records import Record
from tissueid.units import display_unit

_LONGEST_LABEL = 40
LAG = Axis(marked("Lag"), "ms")
TIME = Axis(marked("Time"), "s")
FREQUENCY = Axis(marked("Frequency"), "Hz", log=True)


def signal_axis(name: str, si_unit: str, *, reverse: bool = False) -> Axis:
    """Return label and display unit of the axis for a signal or another quantity, given with its SI unit."""
    label = label_and_unit(name)[0]
    label = label if len(label) <= _LONGEST_LABEL else label[:_LONGEST_LABEL] + "…"
    return Axis(label, display_unit(si_unit)[0], reverse=reverse)


def ratio_unit(record: Record, power: int = 1) -> tuple[str, float]:
    """Return the display unit of output over a power of the input, and the factor from SI to it."""
    out_unit, out_scale = display_unit(record.output_unit)
    in_unit, in_scale = display_unit(record.input_unit)
    raised = "" if power == 1 else superscript(power)
    return f"{out_unit or '1'}/{in_unit or '1'}{raised}", out_scale / in_scale**power


def kernel_unit(record: Record, order: int = 1) -> tuple[str, float]:
    """Return the display unit of a kernel of an order, such as mm/(N·s), and the factor from SI to it."""
    unit, scale = ratio_unit(record, order)
    output, _slash, raised = unit.partition("/")
    seconds = "s" if order == 1 else f"s{superscript(order)}"
    return f"{output}/{seconds}" if raised.startswith("1") else f"{output}/({raised}·{seconds})", scale


def is_mechanical(record: Record) -> bool:
    """Return whether the input is a force and the output a position."""
    return (record.input_unit, record.output_unit) == ("N", "m")
