"""``tissueid reproduce``: figures and tables of the thesis, and those found here."""

from __future__ import annotations

from pathlib import Path

from tissueid.cli.output import check_json, console_control, human_output, table, write_json
from tissueid_lab.thesis.reproduction import ReproductionPlan, answer_of, listed_figures, run_reproduction

_WIDTH = 150


def reproduce_figures(plan: ReproductionPlan, json_file: Path | None) -> None:
    """Make the figures of a plan, and print the numbers of the thesis and those found here.

    Without a folder and figures, list the figures.
    """
    check_json(json_file)
    out = human_output(json_file, width=_WIDTH)
    if plan.out is None and not plan.numbers:
        rows = table("Figures and tables of the thesis", "number", "content")
        for number, title in listed_figures():
            rows.add_row(number, title)
        out.print(rows)
        out.print("--out DIR makes them; name some to make only those")
        if json_file is not None:
            write_json(json_file, {"figures": [{"number": n, "title": str(t)} for n, t in listed_figures()]})
        return
    with console_control() as control:
        made = run_reproduction(plan, control)
    rows = table("Thesis and simulated instrument", "figure", "quantity", "thesis", "here")
    for one in made:
        for row in one.rows:
            rows.add_row(one.number, row.what, row.thesis, row.here)
        if one.why:
            rows.add_row(one.number, one.why, "", "")
    out.print(rows)
    out.print(f"report: {(plan.out or Path()) / 'report.html'}", markup=False)
    if json_file is not None:
        write_json(json_file, {"figures": [answer_of(one) for one in made]})
