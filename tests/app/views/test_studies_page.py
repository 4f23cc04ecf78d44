"""The page of studies: table, filters, analysis that can be cancelled and continues, figures, report, and sittings."""

import json
import shutil
from pathlib import Path

import pytest
from app.benches import WAIT_MS
from app.views.test_clinician import idle, press
from coded import shows
from procedures.test_study import SUBJECTS
from procedures.test_study import folder as sessions  # noqa: F401 - a fixture
from PySide6.QtCore import Qt

from tissueid.analysis.curves.plot import as_csv
from tissueid.app.views.studies import view as studies_view
from tissueid.app.views.studies.request_row import OptionsDialog, ProtocolDialog
from tissueid.app.views.studies.study_data import NOT_ANALYSED, load_study
from tissueid.app.views.studies.tests_tab import SITE, SUBJECT, WITHOUT
from tissueid.app.views.studies.view import StudiesView
from tissueid.errors import UnusableInputError
from tissueid.procedures.session_store import FolderStore
from tissueid.procedures.study_plans import NOT_ANALYSED_FILE, RESULTS
from tissueid.procedures.study_protocol import PROTOCOL_FILE, protocol_text, template

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]

HEAD = "session,subject,site,condition,minutes_since_application,repeat,quality,engine,vaf_percent,problem,m_kg,m_kg_sd"
TESTS = (
    ("a/1.h5", "P01", "arm", "", "", 1, "good", "lms", 80.0, "", 0.003, 0.0001),
    ("a/1.h5", "P01", "arm", "lotion", 60.0, 1, "look", "lms", 85.5, "", 0.002, ""),
    ("b/1.h5", "P02", "leg", "", "", 1, "repeat", "lms", "", "too short", "", ""),
)


@pytest.fixture
def folder(tmp_path):
    """A study with a table of three tests, and a session that is not in it."""
    study = tmp_path / "study"
    (study / RESULTS).mkdir(parents=True)
    lines = [HEAD, *(",".join(map(str, row)) for row in TESTS)]
    (study / RESULTS / "table.csv").write_text("\n".join(lines))
    for name in ("a/1.h5", "b/1.h5", "c/new.h5"):
        (study / name).parent.mkdir(exist_ok=True)
        (study / name).touch()
    return study


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, request):
    """A study of a few sessions, not analysed; tests that change it copy it."""
    path = tmp_path_factory.mktemp("recorded") / "study"
    return Path(shutil.copytree(request.getfixturevalue("sessions"), path))


@pytest.fixture
def open_page(qtbot, host, tmp_path):
    """Opens the page in a window of its own, as another start of the program does."""

    def make(before=None):
        if before is not None:
            before.view.save_state()
        window, _ = host(tmp_path, page=StudiesView)
        qtbot.waitUntil(lambda: idle(window) and not window.view.refresh_timer.isActive(), timeout=WAIT_MS)
        return window

    return make


@pytest.fixture
def window(open_page):
    return open_page()


def opened(qtbot, window, folder):
    page = window.view
    page.open_study(folder)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    return page


def texts(page, column):
    model = page.tests.model
    return [model.data(model.index(row, column)) for row in range(model.rowCount())]


# -- the table ------------------------------------------------------------------------------------------------------


def test_a_study_is_read(folder):
    data = load_study(folder)
    assert (data.tests, data.without_row, data.sessions) == (3, 1, 3)
    assert data.parameters == ("m_kg",)
    assert data.rows[0].problem == NOT_ANALYSED
    name = str(Path("c/new.h5"))
    failed = folder / RESULTS / NOT_ANALYSED_FILE
    failed.write_text(f"session,reason,key\n{name},damaged,{FolderStore(folder).sessions()[name]}\n")
    assert load_study(folder).rows[0].problem == "damaged"
    for text in ("", "rubbish", f"session,reason,key\n{name},damaged,other\n"):
        failed.write_text(text)
        assert load_study(folder).rows[0].problem == NOT_ANALYSED
    assert data.rows[2].minutes == 60.0


@pytest.mark.parametrize("text", ["a,b\n1,2\n", "", "session,subject,site" + ",x" * 1000, "\udcff"])
def test_a_table_that_is_none_is_refused(folder, text):
    (folder / RESULTS / "table.csv").write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(UnusableInputError, match=r"table\.csv"):
        load_study(folder)


def test_rows_are_filtered_and_sorted(qtbot, window, folder):
    page = opened(qtbot, window, folder)
    tests, model = page.tests, page.tests.model
    assert texts(page, SITE) == ["", "arm", "arm", "leg"]
    assert texts(page, SUBJECT)[0].startswith(f"{Path('c/new.h5')}: ")
    assert tests.table.columnSpan(0, 0) == model.columnCount()
    assert shows(tests.count.text(), "study.count", shown=4, count=4, tests=3, sessions=3)
    assert shows(tests.count.text(), "study.without_row", count=1)
    tests.search.setText("P01 LOTION")
    assert texts(page, SITE) == ["arm"]
    assert tests.table.columnSpan(0, 0) == 1
    tests.search.clear()
    tests.site.setCurrentIndex(tests.site.findData("leg"))
    assert texts(page, SUBJECT) == ["P02"]
    tests.site.setCurrentIndex(0)
    tests.condition.setCurrentIndex(tests.condition.findData(WITHOUT))
    assert texts(page, SITE) == ["arm", "leg"]
    tests.condition.setCurrentIndex(0)
    mass = 7
    tests.table.sortByColumn(mass, Qt.SortOrder.AscendingOrder)
    assert texts(page, mass) == ["", "2", "3.00 ± 0.10", "—"]
    tests.table.sortByColumn(mass, Qt.SortOrder.DescendingOrder)
    assert texts(page, mass) == ["", "3.00 ± 0.10", "2", "—"]
    tests.table.sortByColumn(SUBJECT, Qt.SortOrder.DescendingOrder)
    assert texts(page, SUBJECT)[1:] == ["P02", "P01", "P01"]
    assert tests.table.columnSpan(0, 0) == model.columnCount()


def test_columns_are_chosen(qtbot, window, folder):
    page = opened(qtbot, window, folder)
    count = page.tests.model.columnCount()
    (action,) = page.tests.parameters.menu().actions()
    action.setChecked(False)
    assert page.tests.model.columnCount() == count - 1
    action.setChecked(True)
    assert page.tests.model.columnCount() == count


def test_a_folder_that_is_no_study_says_why(qtbot, window, folder, tmp_path):
    page = opened(qtbot, window, tmp_path / "nowhere")
    assert shows(window.said[-1], "file.no_folder")
    assert page.data is None
    (folder / RESULTS / "table.csv").write_text("rubbish")
    opened(qtbot, window, folder)
    assert shows(window.said[-1], "study.table_unreadable")


# -- analysis -------------------------------------------------------------------------------------------------------


def choose_lms(page):
    page.asking.engine.setCurrentIndex(page.asking.engine.findData("lms"))


def test_a_study_is_analysed_drawn_and_reported(qtbot, open_page, recorded):
    window = open_page()
    (recorded / "damaged.h5").write_bytes(b"rubbish" * 99)
    page = opened(qtbot, window, recorded)
    assert page.data.tests == 0
    assert not page.figures.compute.isEnabled()
    choose_lms(page)
    press(qtbot, page.asking.analyse)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert page.data.tests == 4 * SUBJECTS
    assert shows(window.said[-1], "study.analysed", count=1)
    assert "damaged.h5: " in texts(page, SUBJECT)[0]
    assert NOT_ANALYSED not in texts(page, SUBJECT)[0]
    again = opened(qtbot, window, recorded)
    assert texts(again, SUBJECT)[0] == "damaged.h5: is damaged, or not an HDF5 session"
    assert page.asking.bar.isHidden()
    press(qtbot, page.asking.report)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert window.shown == [recorded / RESULTS / "report.html"]
    assert window.shown[0].stat().st_size > 10_000
    page.tabs.setCurrentWidget(page.figures)
    titles = [page.figures.kind.itemText(place) for place in range(page.figures.kind.count())]
    assert titles[:3] == ["Subjects", "Sites", "Variation"]
    assert any(title.startswith("Frequency response") for title in titles)
    for place in range(len(titles)):
        page.figures.kind.setCurrentIndex(place)
        assert page.figures.canvas.plots
    page.figures.kind.setCurrentIndex(0)
    page.figures.parameter.setCurrentIndex(page.figures.parameter.findText("Stiffness"))
    assert page.figures.canvas.plots[0].y.label == "Stiffness"
    parameters = [page.figures.parameter.itemText(place) for place in range(3)]
    assert parameters == ["Mass", "Damping", "Stiffness"]
    assert list(page.data.parameters[:3]) == ["mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"]
    kept = load_study(page.data.folder).figures
    shown = page.figures.figures
    assert [heading for heading, _figures in kept.groups] == titles
    pairs = zip(kept.groups, shown.groups, strict=True)
    assert all(
        [(label, as_csv([plot])) for label, plot in again] == [(label, as_csv([plot])) for label, plot in before]
        for (_head, again), (_same, before) in pairs
    )
    page.data.folder.joinpath(RESULTS, "table.csv").touch()
    assert load_study(page.data.folder).figures is None


def test_a_folder_of_unreadable_sessions_says_why_of_each(qtbot, window, tmp_path):
    for name in ("a.h5", "b.h5"):
        (tmp_path / name).write_bytes(b"rubbish" * 99)
    page = opened(qtbot, window, tmp_path)
    assert NOT_ANALYSED in texts(page, SUBJECT)[0]
    page.analyse()
    qtbot.waitUntil(lambda: idle(window) and NOT_ANALYSED not in texts(page, SUBJECT)[0], timeout=WAIT_MS)
    assert texts(page, SUBJECT) == [f"{name}: is damaged, or not an HDF5 session" for name in ("a.h5", "b.h5")]
    (tmp_path / "a.h5").write_bytes(b"another" * 99)
    assert [row.problem == NOT_ANALYSED for row in load_study(tmp_path).rows] == [True, False]


def test_a_cancelled_analysis_continues(qtbot, window, tmp_path, monkeypatch, recorded):
    others = shutil.ignore_patterns("P[1-9]*", "damaged.h5", RESULTS)
    shutil.copytree(recorded, tmp_path / "s", ignore=others)
    page = opened(qtbot, window, tmp_path / "s")
    choose_lms(page)
    analyse = studies_view.analyse_study

    def cancelled_soon(plan, control):
        checks = []

        def cancelled():
            checks.append(1)
            return len(checks) > 1

        monkeypatch.setattr(control, "cancelled", cancelled)
        return analyse(plan, control)

    monkeypatch.setattr(studies_view, "analyse_study", cancelled_soon)
    page.analyse()
    assert page.asking.stop.isVisible()
    assert not page.asking.analyse.isEnabled()
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert shows(window.said[-1], "study.cancelled")
    assert len(list((tmp_path / "s" / RESULTS).glob("lms-*/*.json"))) == 1
    monkeypatch.setattr(studies_view, "analyse_study", analyse)
    page.analyse()
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert page.data.tests == 4


def test_options_of_the_engine_are_chosen_in_a_form_and_kept(qtbot, open_page, recorded):
    window = open_page()
    page = opened(qtbot, window, recorded)
    choose_lms(page)
    press(qtbot, page.asking.options)
    dialog = page.findChild(OptionsDialog)
    dialog.fields["memory"].set_value(0.04)
    dialog._save()
    assert page.asking.plan(recorded, workers=1).options == ("memory=0.04",)
    page = open_page(window).view
    assert page.asking.plan(recorded, workers=1).options == ("memory=0.04",)
    choose_lms(page)
    page.asking.engine.setCurrentIndex(0)
    assert page.asking.plan(recorded, workers=1).options == ()


# -- protocol and sitting -------------------------------------------------------------------------------------------


def test_a_study_without_a_protocol_gets_one(qtbot, open_window, folder):
    window = open_window()
    window.pages.show("studies")
    page = window.ui.views["studies"]
    page.open_study(folder)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert not page.asking.measure.isVisible()
    press(qtbot, page.asking.template)
    assert not (folder / PROTOCOL_FILE).exists()
    page.findChild(ProtocolDialog)._save()
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert (folder / PROTOCOL_FILE).read_text(encoding="utf-8") == protocol_text(template())
    assert shows(page.asking.protocol.text(), "study.protocol", count=20)
    page.asking.subject.setText("P07")
    press(qtbot, page.asking.measure)
    qtbot.waitUntil(lambda: idle(window) and window.study.leads, timeout=WAIT_MS)
    assert window.ui.page == "measure"
    assert window.ui.form.subject.text() == "P07"
    window.study.dialog.reject()


def test_a_protocol_is_changed_in_a_form(qtbot, window, folder):
    before = template().model_copy(update={"probe": "indenter-4.4mm"})
    (folder / PROTOCOL_FILE).write_text(protocol_text(before))
    page = opened(qtbot, window, folder)
    press(qtbot, page.asking.template)
    dialog = page.findChild(ProtocolDialog)
    assert shows(dialog.problem.text(), "study.visit", count=20)
    dialog.name.setText("Lotion")
    dialog.sites.fill([("left calf", None), ("right calf", 3)])
    dialog.repeats.setValue(2)
    dialog.conditions.fill([("", None, None), ("lotion", 30, None)])
    dialog.asked["ethnicity"].setChecked(True)
    dialog.asked["age_years"].setChecked(False)
    dialog.photograph.setChecked(True)
    assert shows(dialog.problem.text(), "study.visit", count=10)
    dialog.conditions.fill([("", 30, None)])
    assert shows(dialog.problem.text(), "protocol.minutes")
    assert not dialog.save.isEnabled()
    dialog.conditions.fill([("", None, None), ("lotion", "1,5", "north")])
    assert not dialog.save.isEnabled()
    dialog.conditions.fill([("", None, None), ("lotion", "1,5", None)])
    dialog._save()
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    found = page.data.protocol
    assert [(site.site, found.repeats_at(site)) for site in found.sites] == [("left calf", 2), ("right calf", 3)]
    assert found.conditions[1].minutes_since_application == 1.5
    assert (found.name, found.probe, found.photograph) == ("Lotion", before.probe, True)
    assert set(found.demographics) == {*before.demographics, "ethnicity"} - {"age_years"}


def test_without_a_study_the_page_says_what_one_is_and_offers_recent_ones(qtbot, open_page, folder):
    window = open_page()
    page = window.view
    assert page.welcome.isVisible()
    assert not page.tabs.isVisible()
    assert not page.asking.recent.isVisible()
    opened(qtbot, window, folder)
    assert not page.welcome.isVisible()
    (action,) = page.asking.recent.menu().actions()
    page.data = None
    action.trigger()
    qtbot.waitUntil(lambda: page.data is not None and idle(window), timeout=WAIT_MS)
    assert page.data.folder == folder


def test_a_new_study_gets_its_folder(qtbot, window, tmp_path):
    page = window.view
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    page.asking.made.emit(tmp_path / "lotion 2")
    qtbot.waitUntil(lambda: page.data is not None and idle(window), timeout=WAIT_MS)
    assert page.data.folder == tmp_path / "lotion 2"
    assert page.data.folder.is_dir()
    assert page.asking.template.isVisible()


def test_a_bad_protocol_is_stated_on_the_page(qtbot, window, folder):
    (folder / PROTOCOL_FILE).write_text(json.dumps({"name": "x", "sites": []}))
    page = opened(qtbot, window, folder)
    assert shows(page.asking.protocol.text(), "protocol.no_site")
    assert shows(window.said[-1], "protocol.no_site")
    assert "'sites'" in window.said[-1]
    assert not page.asking.measure.isVisible()
    assert not page.asking.template.isVisible()
    assert page.data.tests == 3


def test_the_last_study_is_opened_again(qtbot, open_page, folder):
    window = open_page()
    opened(qtbot, window, folder)
    again = open_page(window)
    qtbot.waitUntil(lambda: idle(again) and again.view.data is not None, timeout=WAIT_MS)
    assert again.view.data.folder == folder
