"""Page of the readings of commercial probes (docs/readings.md)."""

from __future__ import annotations

from tissueid import __version__
from tissueid.analysis.curves.readings import step_plot
from tissueid.analysis.readings.device_readings import DeviceReadings
from tissueid.device import SIMULATED_LINE
from tissueid.formatting import fixed
from tissueid.language import _
from tissueid.messages import translated
from tissueid.reports.blocks import FigureGroup
from tissueid.reports.html import RESEARCH_LINE, template
from tissueid.reports.readings import decay_picture, readings_table, release_picture, step_picture
from tissueid.reports.tables import readable_date
from tissueid.sessions import Session


def readings_page(session: Session, found: DeviceReadings) -> str:
    """Return the page of all readings of a session as HTML text."""
    facts = [
        (_("Subject"), session.subject.pseudonym or _("not recorded")),
        (_("Date"), readable_date(session.created)),
        (_("Instrument"), f"{session.instrument.model}, {session.instrument.serial_number}"),
    ]
    if found.recorded is not None:
        facts.append((_("Step test"), str(found.recorded.test.number)))
    if found.analysis is not None:
        facts.append((_("Model"), f"{found.analysis.model.report.engine}, {_('test')} {found.analysis.test}"))
    if found.course is not None:
        low, high = fixed(found.course.low_n, 2), fixed(found.course.high_n, 2)
        facts.append((_("Force"), _("{low} to {high} N").format(low=low, high=high)))
        facts.append((_("Hold"), f"{fixed(found.course.hold_s, 2)} s"))
    pictures = [step_picture("step", step_plot(found)), decay_picture(found)]
    if found.recorded is not None:
        pictures.append(release_picture("release", found.recorded))
    return template("readings.html.j2").render(
        title=_("Readings for comparison with other probes"),
        facts=facts,
        session_id=session.session_id,
        simulated=_(SIMULATED_LINE) if session.instrument.simulated else "",
        research_line=_(RESEARCH_LINE),
        software=f"tissueid {__version__}",
        notes=[translated(note) for note in found.notes],
        table=readings_table(found.rows()),
        group=FigureGroup("figures", _("Figures"), tuple(one.block for one in pictures)),
    )
