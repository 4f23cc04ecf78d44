"""Which rows of the list are shown: those that have every word that is typed, and what the choices ask for."""

from __future__ import annotations

from collections.abc import Iterator

from PySide6.QtCore import QModelIndex, QObject, QPersistentModelIndex, QSortFilterProxyModel, Qt

from tissueid.app.views.researcher.index import Entry, TestEntry
from tissueid.app.views.researcher.session_model import DATE, ITEM, SORT, WORDS, SessionModel


class SessionFilter(QSortFilterProxyModel):
    """A session is shown when one of its tests is; a file that is no session while nothing but words are asked for."""

    def __init__(self, model: SessionModel, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._words: tuple[str, ...] = ()
        self._subject = self._site = self._kind = ""
        self.setSourceModel(model)
        self.setSortRole(SORT)
        self.sort(DATE, Qt.SortOrder.DescendingOrder)

    def ask(self, words: str, subject: str, site: str, kind: str) -> None:
        """Show what has all these; an empty text asks for nothing."""
        asked = tuple(words.casefold().split()), subject, site, kind
        if asked != (self._words, self._subject, self._site, self._kind):
            self._words, self._subject, self._site, self._kind = asked
            self.invalidateFilter()

    def filterAcceptsRow(self, row: int, parent: QModelIndex | QPersistentModelIndex) -> bool:  # noqa: N802
        """Whether a row of the list is shown."""
        model = self.sourceModel()
        index = model.index(row, DATE, parent)
        item = model.data(index, ITEM)
        if isinstance(item, TestEntry):
            return self._wants(model.data(parent, ITEM), item, model.data(index, WORDS))
        if not isinstance(item, Entry):
            return False
        if not item.tests:
            bare = not (self._site or self._kind) and self._subject in ("", item.pseudonym)
            return bare and self._has_words(model.data(index, WORDS))
        tests = range(model.rowCount(index))
        return any(
            self._wants(item, test, model.data(model.index(place, DATE, index), WORDS))
            for place, test in zip(tests, item.tests, strict=True)
        )

    def shown(self) -> Iterator[tuple[QModelIndex, Entry]]:
        """The files that are shown, in order, and their places here."""
        for row in range(self.rowCount()):
            index = self.index(row, DATE)
            yield index, self.data(index, ITEM)

    def _wants(self, entry: Entry, test: TestEntry, words: str) -> bool:
        return (
            self._subject in ("", entry.pseudonym)
            and self._site in ("", test.site)
            and self._kind in ("", test.kind)
            and self._has_words(words)
        )

    def _has_words(self, words: str) -> bool:
        return all(word in words for word in self._words)


__all__ = ["SessionFilter"]
