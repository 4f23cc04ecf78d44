"""Other sites and earlier sittings of the same subject in the folder of sessions, and the card that shows them."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import Qt
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QFrame, QLabel, QVBoxLayout, QWidget

from tissueid.app.build import button, fill, label, styled
from tissueid.app.plot_canvas import PlotCanvas
from tissueid.app.small_window import FoldingBox
from tissueid.app.views.clinician.sitting import QUANTITIES, repeatability, together, values_of
from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.formatting import ANONYMOUS, clean, fixed, label_and_unit, local_minute
from tissueid.language import _, marked
from tissueid.messages import Message, Verbatim, sentences, translated
from tissueid.procedures.study_protocol import PROTOCOL_FILE
from tissueid.records import Estimate
from tissueid.sessions import Session, Test, read_outline, read_session, read_session_head
from tissueid.sessions.accepted_result import AcceptedResult, read_result
from tissueid.sessions.quality import quality_of
from tissueid.units import display_unit

if TYPE_CHECKING:
    from tissueid.analysis.curves.plot import Plot


MOST_READ = 20
"""Maximum number of sessions of a subject that are identified, newest first."""
MOST_LOOKED_AT = 2000
"""Maximum number of files whose headers are read."""
LARGEST_BYTES = 50_000_000
"""A larger file is a long sitting of a researcher, and takes a while to read."""
MOST_SHOWN = 8
_LONGEST_SITE = 26
OTHER_INSTRUMENT = "†"
"""Mark of a sitting that was measured with another instrument than the shown test."""
STUDY = "study"
"""Key of the row with the mean of the other subjects of a study."""
_FEWEST_SUBJECTS = 3
"""Other subjects of a study from which their mean and deviation are shown."""
_MOST_RESULTS = 1000
"""Accepted results of a study that are read."""
_OF_OTHERS = Message("comparison.other_instrument", "† measured with another instrument: compare with care.")


@dataclass(frozen=True)
class Sighting:
    """What one sitting found at one site. ``values`` have the deviation of one test; ``count`` tests went into it.

    ``instrument`` says with what; ``other_instrument`` is true where that is not what the shown test was made with.
    """

    key: str
    created: str
    site: str
    values: dict[str, Estimate]
    count: int = 1
    this: bool = False
    instrument: str = ""
    other_instrument: bool = False

    @property
    def label(self) -> str:
        """Local date and time, the number of tests where they are several, and the site, short."""
        if self.key == STUDY:
            return translated(Message("comparison.study_row", "Study: {count} other subjects", count=self.count))
        site = clean(self.site)
        site = site if len(site) <= _LONGEST_SITE else site[: _LONGEST_SITE - 1] + "…"
        when = local_minute(self.created) or self.created[:10]
        mark = OTHER_INSTRUMENT if self.other_instrument else ""
        return "  ".join(filter(None, [f"{when}{mark}", f"×{self.count}" if self.count > 1 else "", site]))


@dataclass(frozen=True)
class SittingComparison:
    """Sightings, newest first, the test that is asked about among them. ``left_out`` says what was not read.

    ``changes`` says by quantity how the values differ from the sitting before at the same site.
    """

    sightings: tuple[Sighting, ...] = ()
    left_out: str = ""
    changes: Mapping[str, str] = field(default_factory=dict)

    @property
    def remark(self) -> str:
        """What to bear in mind where several instruments are compared; empty otherwise."""
        return _OF_OTHERS if any(sighting.other_instrument for sighting in self.sightings) else ""


@dataclass
class Shelf:
    """Cache of identified sessions, by file; an entry is valid while its file is unchanged."""

    kept: dict[tuple[Path, int, int], tuple[Sighting, ...]] = field(default_factory=dict)
    results: dict[tuple[Path, int], tuple[AcceptedResult, Test] | None] = field(default_factory=dict)
    """Accepted results of studies, each with its first test, by file and time of change."""


def compare_with(
    folder: Path, session: Session, path: Path, test: Test, shelf: Shelf, cancelled: threading.Event
) -> SittingComparison:
    """Return the sittings of the subject of a session in a folder; other files are ignored.

    A subject without a pseudonym is not compared: it could be anyone.
    """
    if session.subject.pseudonym == ANONYMOUS:
        return SittingComparison()
    mine, skipped = _files_of(folder, session.subject.pseudonym, path, cancelled)
    sightings: list[Sighting] = []
    for file in [path, *mine[:MOST_READ]]:
        if cancelled.is_set():
            return SittingComparison(left_out=Message("comparison.cancelled", "The comparison was cancelled."))
        try:
            state = file.stat()
            key = (file, state.st_mtime_ns, state.st_size)
            if key not in shelf.kept:
                shelf.kept[key] = tuple(_sightings(session if file == path else read_session(file)))
            sightings += shelf.kept[key]
        except (TissueIDError, OSError):
            skipped += 1
    here = (str(test.notes.get("sitting") or session.session_id), test.site)
    joined = [
        replace(
            sighting,
            this=(sighting.key, sighting.site) == here,
            other_instrument=sighting.instrument != _instrument(session),
        )
        for sighting in _joined(sightings)
    ]
    joined.sort(key=lambda sighting: sighting.created, reverse=True)
    shown = joined[:MOST_SHOWN]
    if not any(sighting.this for sighting in shown):
        shown = [*shown[: MOST_SHOWN - 1], *(sighting for sighting in joined if sighting.this)]
    remarks = []
    if len(mine) > MOST_READ or len(joined) > len(shown):
        remarks.append(Message("comparison.newest", "Only the newest {count} sittings are shown.", count=len(shown)))
    if skipped == 1:
        remarks.append(Message("comparison.file_skipped", "1 file was passed over."))
    elif skipped:
        remarks.append(Message("comparison.files_skipped", "{count} files were passed over.", count=skipped))
    said, study = changes(joined), of_study(path, test, shelf, cancelled)
    this = next((sighting for sighting in joined if sighting.this), None)
    if study is not None and this is not None:
        said |= {name: sentences(said.get(name, ""), text) for name, text in against(study, this).items()}
        shown.append(study)
    return SittingComparison(tuple(shown), sentences(*remarks) if remarks else "", said)


def of_study(path: Path, test: Test, shelf: Shelf, cancelled: threading.Event) -> Sighting | None:
    """Return mean and standard deviation of the other subjects of a study at the site and condition of a test.

    They are those of the newest accepted result of each subject for such a test: the window accepts values of the
    engine that it shows. None outside a study, or with fewer than three other subjects.
    """
    study = path.resolve().parent.parent
    if not (study / PROTOCOL_FILE).exists():
        return None
    newest: dict[str, AcceptedResult] = {}
    for file in sorted(study.glob("*/sitting-*.json"))[:_MOST_RESULTS]:
        if cancelled.is_set():
            return None
        subject = file.parent.name
        accepted = None if subject == path.resolve().parent.name else _accepted(file, shelf)
        if accepted is None or _what_of(accepted[1]) != _what_of(test):
            continue
        if subject not in newest or newest[subject].accepted < accepted[0].accepted:
            newest[subject] = accepted[0]
    values = {}
    for name in QUANTITIES:
        means = [result.values[name].mean for result in newest.values() if name in result.values]
        if len(means) >= _FEWEST_SUBJECTS:
            values[name] = Estimate(float(np.mean(means)), float(np.std(means, ddof=1)))
    return Sighting(STUDY, "", test.site, values, len(newest)) if values else None


def _accepted(file: Path, shelf: Shelf) -> tuple[AcceptedResult, Test] | None:
    """Return an accepted result with its first test, which has no signals; None if one of them cannot be read."""
    try:
        key = (file, file.stat().st_mtime_ns)
        if key not in shelf.results:
            shelf.results[key] = None
            result = read_result(file)
            first = result.tests[0]
            tests = [entry.test for entry in read_outline(file.parent / first.file).tests]
            shelf.results[key] = next(((result, test) for test in tests if test.number == first.number), None)
        return shelf.results[key]
    except (TissueIDError, OSError):
        return None


def _what_of(test: Test) -> tuple[object, ...]:
    """Return what two tests must have in common to be compared across subjects."""
    return test.site, test.kind, test.configuration, test.notes.get("condition", "")


def against(study: Sighting, this: Sighting) -> dict[str, Message]:
    """Return by quantity how a sitting differs from the mean of the other subjects of its study."""
    said = {}
    for name, mean in study.values.items():
        if (now := this.values.get(name)) is None or not mean.value or mean.std is None:
            continue
        percent = 100.0 * (now.value - mean.value) / abs(mean.value)
        values = {
            "percent": fixed(abs(percent), 0),
            "count": study.count,
            "spread": fixed(100.0 * mean.std / abs(mean.value), 0),
        }
        if percent > 0.0:
            said[name] = Message(
                "comparison.study_above",
                "{percent} % above the mean of {count} other subjects of the study (± {spread} %).",
                **values,
            )
        else:
            said[name] = Message(
                "comparison.study_below",
                "{percent} % below the mean of {count} other subjects of the study (± {spread} %).",
                **values,
            )
    return said


def changes(sightings: Sequence[Sighting]) -> dict[str, str]:
    """Return by quantity how this sitting differs from the newest one before it at its site, with its instrument.

    A difference counts if it is larger than the repeatability, the root mean square of that of both sittings.
    ``sightings`` are the newest first.
    """
    this = next((sighting for sighting in sightings if sighting.this), None)
    if this is None:
        return {}
    earlier = (
        sighting
        for sighting in sightings
        if sighting.created < this.created and not sighting.this and sighting.site == this.site
    )
    before = next((sighting for sighting in earlier if not sighting.other_instrument), None)
    if before is None:
        return {}
    date = (local_minute(before.created) or before.created)[:10]
    said: dict[str, str] = {}
    for quantity in QUANTITIES:
        now, then = this.values.get(quantity), before.values.get(quantity)
        if now is None or then is None or now.std is None or then.std is None or not then.value:
            continue
        limits = repeatability(now.std, this.count), repeatability(then.std, before.count)
        difference = now.value - then.value
        percent = 100.0 * difference / abs(then.value)
        values = {"percent": fixed(abs(percent), 0), "date": date}
        if abs(difference) <= math.hypot(*limits) / math.sqrt(2.0):
            said[quantity] = Message(
                "comparison.same", "As on {date}: {percent} % apart, within the repeatability.", **values
            )
        elif difference > 0.0:
            said[quantity] = Message(
                "comparison.higher", "{percent} % higher than on {date}, beyond the repeatability.", **values
            )
        else:
            said[quantity] = Message(
                "comparison.lower", "{percent} % lower than on {date}, beyond the repeatability.", **values
            )
    return said


def _files_of(folder: Path, pseudonym: str, path: Path, cancelled: threading.Event) -> tuple[list[Path], int]:
    """Return the other sessions of a subject in a folder, newest first, and the number of unusable files."""
    try:
        files = [file for file in folder.glob("*.h5") if file.is_file() and file.resolve() != path.resolve()]
        files.sort(key=lambda file: file.stat().st_mtime, reverse=True)
    except OSError:
        return [], 0
    dated: list[tuple[str, Path]] = []
    skipped = 0
    for file in files[:MOST_LOOKED_AT]:
        if cancelled.is_set():
            break
        try:
            head = read_session_head(file)
            if head.subject.pseudonym != pseudonym:
                continue
            if file.stat().st_size > LARGEST_BYTES:
                skipped += 1
                continue
        except (TissueIDError, OSError):
            skipped += 1
            continue
        dated.append((head.created, file))
    return [file for _, file in sorted(dated, reverse=True)], skipped


def _sightings(session: Session) -> Iterable[Sighting]:
    """One a test that can be identified and that the gate did not want repeated."""
    from tissueid.analysis import analyse_all
    from tissueid.identification.engines.lms import Lms

    for test in session.tests:
        quality = quality_of(test)
        if test.kind != "stochastic" or test.status != "completed" or (quality and quality.verdict == "repeat"):
            continue
        try:
            values = values_of(analyse_all(session, (Lms.name,), test=test))
        except UnusableInputError:
            continue
        if values:
            key = str(test.notes.get("sitting") or session.session_id)
            yield Sighting(key, session.created, test.site, values, instrument=_instrument(session))


def _instrument(session: Session) -> str:
    return f"{session.instrument.model} {session.instrument.serial_number}"


def _joined(sightings: Sequence[Sighting]) -> list[Sighting]:
    """Sightings of one sitting at one site as one: their mean, with the deviation of one test among them."""
    groups: dict[tuple[str, str], list[Sighting]] = {}
    for sighting in sightings:
        groups.setdefault((sighting.key, sighting.site), []).append(sighting)
    return [group[0] if len(group) == 1 else _mean(group) for group in groups.values()]


def _mean(group: Sequence[Sighting]) -> Sighting:
    values = {}
    for name in QUANTITIES:
        estimates = [
            sighting.values[name]
            for sighting in group
            if name in sighting.values and math.isfinite(sighting.values[name].value)
        ]
        if (said := together(estimates)) is not None:
            values[name] = Estimate(said.mean, said.std)
        elif estimates:
            values[name] = Estimate(estimates[0].value, None)
    return replace(group[0], values=values, count=len(group), created=max(sighting.created for sighting in group))


_ROW = 17
_AROUND = 75
"""Height of a row, and of what is around the rows, pixels."""
_ONE_ROW = 600
"""Width below which the plots stand below each other, pixels."""
_LEGEND = marked(
    "Bars: one standard deviation, of the estimate where a sitting has one test, of its repeats otherwise."
)
READING = marked("Reading the subject's other sittings…")
THIS, _OTHERS = marked("this sitting"), marked("others")


class ComparisonCard(QFrame):
    """Hidden until there is something to compare with; its plots are built then. ``cancel`` ends the reading."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.heading = styled(
            QLabel(_("Compared with the subject's other sites and sittings")), role="heading", minimum_width=1
        )
        self.remarks, self.cancel = label("field"), button(_("Cancel comparison"))
        top = fill(FoldingBox(_ONE_ROW), self.heading, (self.remarks, 1), self.cancel, margins=(2, 0, 0, 0))
        self.cards: list[PlotCanvas] = []
        self._plots: list[Plot] = []
        self._layout = fill(QVBoxLayout(self), top, spacing=3)
        self._folded = False
        self.hide()

    def expect(self) -> None:
        """The folder is being read."""
        self.remarks.setText(_(READING))
        self.cancel.show()
        for card in self.cards:
            card.hide()
        self.show()

    def clear(self) -> None:
        """There is nothing to compare with."""
        self.hide()

    def show_comparison(self, comparison: SittingComparison) -> None:
        """Show the sittings, the newest on top; nothing where there is but one."""
        sightings = comparison.sightings
        self.cancel.hide()
        if len(sightings) < 2:
            self.hide()
            return
        self._build_plots()
        self.remarks.setText(" ".join(map(translated, filter(None, [comparison.remark, comparison.left_out]))))
        self._plots = [_plot_of(quantity, sightings) for quantity in QUANTITIES]
        for card in self.cards:
            card.setFixedHeight(_AROUND + _ROW * max(3, len(sightings)))
            card.show()
        self._show_plots()
        said = "; ".join(f"{sighting.label}{', ' + _(THIS) if sighting.this else ''}" for sighting in sightings)
        self.setAccessibleName(_("Comparison of {count} sittings: {said}").format(count=len(sightings), said=said))
        self.show()

    def _build_plots(self) -> None:
        if self.cards:
            return
        row = FoldingBox(_ONE_ROW)
        row.setSpacing(8)
        for index, quantity in enumerate(QUANTITIES):
            card = PlotCanvas(_(label_and_unit(quantity)[0]))
            card.focus = Qt.FocusPolicy.ClickFocus  # the page is scrolled by keys, not stop by stop
            self.cards.append(card)
            row.addWidget(card, 0 if index else 1)
            row.setStretch(index, 30 if index else 47)
        self._layout.addLayout(row)

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Name the sittings at every plot where the plots stand below each other."""
        super().resizeEvent(event)
        folded = event.size().width() < _ONE_ROW
        if folded != self._folded:
            self._folded = folded
            self.heading.setWordWrap(folded)
            self._show_plots()

    def _show_plots(self) -> None:
        """Draw the plots; those right of another one have neither names of the rows nor a key."""
        for index, (card, plot) in enumerate(zip(self.cards, self._plots, strict=False)):
            named = index == 0 or self._folded
            ticks = plot.y.ticks if named else tuple((row, "") for row, _name in plot.y.ticks)
            card.show_plots([replace(plot, y=replace(plot.y, ticks=ticks))], key=index == 0)


def _plot_of(quantity: str, sightings: Sequence[Sighting]) -> Plot:
    """Return the plot of a quantity: a row for each sitting."""
    # Late: these bring the identification with numba, and the window opens before there is anything to compare.
    from tissueid.analysis.curves.comparison_plots import rows_plot
    from tissueid.analysis.curves.plot import Axis

    label, si_unit = label_and_unit(quantity)
    unit, scale = display_unit(si_unit)
    estimates = [sighting.values.get(quantity) for sighting in sightings]
    values = np.array([np.nan if estimate is None else scale * estimate.value for estimate in estimates])
    std = np.array(
        [np.nan if estimate is None or estimate.std is None else scale * estimate.std for estimate in estimates]
    )
    this = np.array([sighting.this for sighting in sightings])
    groups = ((_OTHERS, "measured", np.flatnonzero(~this)), (THIS, "model", np.flatnonzero(this)))
    names = [Verbatim(sighting.label) for sighting in sightings]
    plot = rows_plot(label, Axis(marked("± one SD"), unit), names, values, std, groups)
    return replace(plot, note=_LEGEND)
