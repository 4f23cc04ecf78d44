"""Reads a page as a strict reader would: every element closed, every reference resolved, nothing fetched."""

from __future__ import annotations

import re
from html.parser import HTMLParser

from tissueid.language import current_language

VOID = {"meta", "link", "br", "hr", "img", "input"}
EMPTY_SVG = {"path", "use", "rect", "circle", "line", "image", "polygon", "polyline"}


class Page(HTMLParser):
    """``text`` is what a person reads; ``ids``, ``targets`` and ``tags`` are what a browser sees."""

    def __init__(self, source: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.ids: list[str] = []
        self.targets: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(source)
        self.close()
        assert not self.open, f"not closed: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = dict(attrs)
        assert len(attributes) == len(attrs), f"an attribute twice on {tag}"
        self.tags.append((tag, attributes))
        if (identity := attributes.get("id")) is not None:
            self.ids.append(identity)
        for value in attributes.values():
            self.targets += re.findall(r"url\(#([^)]+)\)", value or "")
        for name in ("href", "xlink:href"):
            if (target := attributes.get(name) or "").startswith("#"):
                self.targets.append(target[1:])
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open[-1] == tag, f"</{tag}> closes <{self.open[-1]}>"
        self.open.pop()

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.text += data + "\n"

    def named(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for found, attributes in self.tags if found == tag]


def checked(source: str) -> Page:
    """Parse a page and hold it to what every report promises."""
    assert source.startswith("<!DOCTYPE html>")
    page = Page(source)
    assert len(page.ids) == len(set(page.ids)), "an id is used twice"
    assert set(page.targets) <= set(page.ids), set(page.targets) - set(page.ids)
    assert not page.named("script")
    assert not page.named("link")
    for tag, attributes in page.tags:
        assert not any(name.startswith("on") for name in attributes), (tag, attributes)
        for name in ("src", "href", "xlink:href", "action"):
            target = attributes.get(name) or "#"
            assert target.startswith(("#", "data:image/png;base64,")), (tag, target)
    assert "@import" not in source
    assert not re.search(r"url\((?!#)", source)
    assert page.named("html")[0].get("lang") == current_language()
    for svg in page.named("svg"):
        assert svg.get("role") == "img"
        assert svg.get("aria-label")
    for header in page.named("th"):
        assert header.get("scope") in ("row", "col")
    wrong = {"nan", "inf", "undefined", "traceback"} | (
        {"null"} if current_language() == "en" else set()
    )  # a German word
    assert not wrong & set(re.findall(r"\w+", page.text.lower()))
    assert not re.findall(r">\s*None\s*<|\bNone(?=[,;)])", source)
    return page
