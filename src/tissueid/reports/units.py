"""Units of what is drawn, as people read them."""

from __future__ import annotations

from tissueid.records import Record
from tissueid.wording import people_unit, superscript


def ratio_unit(record: Record, power: int = 1) -> tuple[str, float]:
    """Unit of output over a power of the input as people read it, and how many of it make one of SI."""
    out_unit, out_scale = people_unit(record.output_unit)
    in_unit, in_scale = people_unit(record.input_unit)
    raised = "" if power == 1 else superscript(power)
    return f"{out_unit or '1'}/{in_unit or '1'}{raised}", out_scale / in_scale**power


def kernel_unit(record: Record, order: int = 1) -> tuple[str, float]:
    """Unit of a kernel of an order as people read it, and how many of it make one of SI."""
    unit, scale = ratio_unit(record, order)
    return f"{unit} per s{'' if order == 1 else superscript(order)}", scale


def is_mechanical(record: Record) -> bool:
    """Whether force goes in and position comes out."""
    return (record.input_unit, record.output_unit) == ("N", "m")
