"""Filter of the list of sessions by search words, subject, site and kind."""

from __future__ import annotations

from collections.abc import Iterator

from PySide6.QtCore import QModelIndex, QObject, QPersistentModelIndex, QSortFilterProxyModel, Qt

from tissueid.app.views.researcher.session_model import DATE, ITEM, SORT, WORDS, SessionModel
from tissueid.app.views.researcher.session_search import SessionEntry, TestEntry


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
        """Set the search words and filters; "" is no filter."""
        asked = tuple(words.casefold().split()), subject, site, kind
        if asked != (self._words, self._subject, self._site, self._kind):
            self._words, self._subject, self._site, self._kind = asked
            self.invalidateFilter()

    def filterAcceptsRow(self, row: int, parent: QModelIndex | QPersistentModelIndex) -> bool:  # noqa: N802
        """Return whether a row is shown."""
        model = self.sourceModel()
        index = model.index(row, DATE, parent)
        item = model.data(index, ITEM)
        if isinstance(item, TestEntry):
            return self._wants(model.data(parent, ITEM), item, model.data(index, WORDS))
        if not isinstance(item, SessionEntry):
            return False
        if not item.tests:
            bare = not (self._site or self._kind) and self._subject in ("", item.pseudonym)
            return bare and self._has_words(model.data(index, WORDS))
        tests = range(model.rowCount(index))
        return any(
            self._wants(item, test, model.data(model.index(place, DATE, index), WORDS))
            for place, test in zip(tests, item.tests, strict=True)
        )

    def shown(self) -> Iterator[tuple[QModelIndex, SessionEntry]]:
        """Yield the shown files in order, with their indices."""
        for row in range(self.rowCount()):
            index = self.index(row, DATE)
            yield index, self.data(index, ITEM)

    def _wants(self, entry: SessionEntry, test: TestEntry, words: str) -> bool:
        return (
            self._subject in ("", entry.pseudonym)
            and self._site in ("", test.site)
            and self._kind in ("", test.kind)
            and self._has_words(words)
        )

    def _has_words(self, words: str) -> bool:
        return all(word in words for word in self._words)


__all__ = ["SessionFilter"]
