"""The page Studies with 5,000 tests: open a study, filter and sort its table; against pandas with Qt's own models.

A table of 5,000 tests of 1,000 sessions with the parameters of the Wiener engine is generated. Opening includes the
file, the list of sessions, and the first painting; filtering and sorting include the painting.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from PySide6.QtCore import QSortFilterProxyModel, Qt
from PySide6.QtGui import QStandardItem, QStandardItemModel
from PySide6.QtWidgets import QApplication, QTableView

from benchmarks.base import Latency
from tissueid.app.views.studies.study_data import load_study
from tissueid.app.views.studies.tests_tab import TestsTab
from tissueid.procedures.study_plans import RESULTS

Array = NDArray[np.float64]
SUBJECTS, SITES, REPEATS, PER_SESSION = 125, ("LP", "LA", "RP", "RA"), 10, 5
PARAMETERS = (
    *("damping_ratio", "natural_frequency_rad_per_s", "scaled_mass_s2", "scaled_damping_s", "c1_m", "c2_per_n"),
    *("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"),
)
SIZE = (1280, 720)
WORDS = ("", "p-012", "la good", "nothing like that", "1", "p-1 repeat", "ra")
OPEN_S, FILTER_S = 1.0, 0.1


def latencies() -> Iterable[Latency]:
    os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    application = QApplication.instance() or QApplication(["benchmarks"])
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    make_study(folder)
    ours, theirs = _Page(folder), _Plain(folder)
    _kept.extend([application, ours, theirs])
    setting = f"{SUBJECTS * len(SITES) * REPEATS:,} tests, {len(PARAMETERS)} parameters"
    yield Latency("open a study", setting, ours.opened, theirs.opened, 0.0, OPEN_S, blocks=3, plain_blocks=1)
    yield Latency("filter by words", setting, ours.filtered, theirs.filtered, 0.0, FILTER_S, blocks=3, plain_blocks=1)
    yield Latency("filter by site", setting, ours.by_site, theirs.by_site, 0.0, FILTER_S, blocks=3, plain_blocks=1)
    yield Latency("sort by a parameter", setting, ours.sorted, theirs.sorted, 0.0, FILTER_S, blocks=3, plain_blocks=1)


_kept: list[object] = []
"""Windows kept alive during timing."""


def make_study(folder: Path, subjects: int = SUBJECTS) -> None:
    """Write the table of a study, and an empty file for each session."""
    random = np.random.default_rng(0)
    tests = [(f"P-{who:03d}", site, n + 1) for who in range(subjects) for site in SITES for n in range(REPEATS)]
    count = len(tests)
    sessions = [f"{who}/{site}-{(n - 1) // PER_SESSION}.h5" for who, site, n in tests]
    columns = {
        "session": sessions,
        "test": [(n - 1) % PER_SESSION + 1 for _who, _site, n in tests],
        "subject": [who for who, _site, _n in tests],
        "site": [site for _who, site, _n in tests],
        "condition": ["" if n <= REPEATS // 2 else "lotion" for _who, _site, n in tests],
        "minutes_since_application": [np.nan if n <= REPEATS // 2 else 60.0 for _who, _site, n in tests],
        "repeat": [n for _who, _site, n in tests],
        "status": ["completed"] * count,
        "quality": random.choice(["good", "look", "repeat"], count).tolist(),
        "engine": ["wiener"] * count,
        "vaf_percent": random.uniform(70.0, 90.0, count),
        "problem": [""] * count,
    }
    for name in PARAMETERS:
        columns[name] = random.normal(1.0, 0.1, count)
        columns[f"{name}_sd"] = np.full(count, 0.05)
    (folder / RESULTS).mkdir(parents=True)
    pd.DataFrame(columns).to_csv(folder / RESULTS / "table.csv", index=False)
    for session in dict.fromkeys(sessions):
        path = folder / session
        path.parent.mkdir(exist_ok=True)
        path.touch()


def _timed(steps: Iterable[Callable[[], int]]) -> tuple[Array, Array]:
    """Return seconds and number of rows of each step."""
    seconds, rows = [], []
    for step in steps:
        start = time.perf_counter()
        rows.append(float(step()))
        seconds.append(time.perf_counter() - start)
    return np.array(seconds), np.array(rows)


class _Page:
    """The tests of the page."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._tab = TestsTab()
        self._tab.resize(*SIZE)
        self._tab.show()
        QApplication.processEvents()

    def opened(self) -> tuple[Array, Array]:
        return _timed([self._open] * 3)

    def filtered(self) -> tuple[Array, Array]:
        return _timed([lambda words=words: self._ask(words) for words in WORDS])

    def by_site(self) -> tuple[Array, Array]:
        self._ask("")
        return _timed([lambda place=place: self._choose(place) for place in (1, 2, 3, 0)])

    def sorted(self) -> tuple[Array, Array]:
        return _timed([lambda order=order: self._sort(order) for order in Qt.SortOrder])

    def _open(self) -> int:
        self._tab.show_study(load_study(self._folder))
        return self._painted()

    def _ask(self, words: str) -> int:
        self._tab.search.setText(words)
        return self._painted()

    def _choose(self, place: int) -> int:
        self._tab.site.setCurrentIndex(place)
        return self._painted()

    def _sort(self, order: Qt.SortOrder) -> int:
        self._tab.table.sortByColumn(7, order)
        return self._painted()

    def _painted(self) -> int:
        self._tab.table.viewport().repaint()
        return self._tab.model.rowCount()


class _Plain:
    """The table read by pandas, in Qt's own models."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / RESULTS / "table.csv"
        self._view = QTableView()
        self._proxy = QSortFilterProxyModel()
        self._proxy.setFilterKeyColumn(-1)
        self._proxy.setFilterCaseSensitivity(Qt.CaseSensitivity.CaseInsensitive)
        self._view.setModel(self._proxy)
        self._view.resize(*SIZE)
        self._view.show()
        self._table = pd.DataFrame()

    def opened(self) -> tuple[Array, Array]:
        return _timed([self._open] * 3)

    def filtered(self) -> tuple[Array, Array]:
        return _timed([lambda words=words: self._ask(words) for words in WORDS])

    def by_site(self) -> tuple[Array, Array]:
        return _timed([lambda site=site: self._choose(site) for site in ("LA", "LP", "RA", "")])

    def sorted(self) -> tuple[Array, Array]:
        return _timed([lambda order=order: self._sort(order) for order in Qt.SortOrder])

    def _open(self) -> int:
        self._table = pd.read_csv(self._path, keep_default_na=False)
        model = QStandardItemModel()
        model.setHorizontalHeaderLabels(list(self._table))
        for row in self._table.astype(str).to_numpy():
            model.appendRow([QStandardItem(cell) for cell in row])
        self._model = model
        self._proxy.setSourceModel(model)
        self._view.repaint()
        return self._proxy.rowCount()

    def _ask(self, words: str) -> int:
        """Every word in any column of the text, as the page searches."""
        texts = self._table[["subject", "site", "condition", "quality", "engine", "problem", "session"]]
        joined = texts.agg(" ".join, axis=1).str.casefold()
        found = [joined.str.contains(word, regex=False) for word in words.casefold().split()]
        shown = np.all(found, axis=0) if found else np.ones(len(joined), bool)
        for row in range(len(joined)):
            self._view.setRowHidden(row, not shown[row])
        self._view.viewport().repaint()
        return int(shown.sum())

    def _choose(self, site: str) -> int:
        self._proxy.setFilterKeyColumn(list(self._table).index("site"))
        self._proxy.setFilterFixedString(site)
        self._view.viewport().repaint()
        return self._proxy.rowCount()

    def _sort(self, order: Qt.SortOrder) -> int:
        self._proxy.sort(list(self._table).index(PARAMETERS[0]), order)
        self._view.viewport().repaint()
        return self._proxy.rowCount()
