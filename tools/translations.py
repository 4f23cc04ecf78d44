"""Extract the texts of the program, update the gettext catalogues and compile them.

    .venv/bin/python tools/translations.py            # `make translations`: update and compile every catalogue
    .venv/bin/python tools/translations.py --compile  # compile the catalogues that are newer than their compiled form
    .venv/bin/python tools/translations.py --check    # status 1: a text is not translated, or an entry is not used
    .venv/bin/python tools/translations.py --add fr "Français"   # begin another language

A text is extracted from ``_("...")``, ``marked("...")``, ``plural("...", "...", n)``, ``Message(code, "...")`` and
``SomeError(code, "...")`` in Python, from the declarations of effects (``DECLARED``), and from ``_("...")`` in
templates. An entry that the program
no longer uses is removed.
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from babel.messages.catalog import Catalog, Message
from babel.messages.extract import extract_from_dir
from babel.messages.mofile import write_mo
from babel.messages.pofile import read_po, write_po

SOURCE = Path(__file__).parents[1] / "src"
PACKAGES = (SOURCE / "tissueid", SOURCE / "tissueid_lab")
FOLDER = SOURCE / "tissueid" / "languages"
CATALOGUE = "LC_MESSAGES/tissueid.po"
KEYWORDS = {"_": None, "marked": None, "plural": (1, 2), "Message": (2,), "Effect": None, "Parameter": None}
DECLARED = {"Effect": ("title", "signature", "remedy"), "Parameter": ("meaning",)}
"""Keyword arguments of declarations whose constants are texts: an effect is translated without further marks."""
_BEGIN = datetime(2026, 1, 1, tzinfo=UTC)
"""Date in the header of a catalogue. It is fixed, so that an update changes texts only."""


def from_python(
    file: BinaryIO, keywords: Any, comment_tags: Any, options: Any
) -> Iterator[tuple[int, str, Any, list[str]]]:
    """Yield the calls that mark a text, from the syntax tree: Babel's own extractor misses those inside f-strings."""
    del comment_tags, options  # part of the interface
    for node in ast.walk(ast.parse(file.read())):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)):
            continue
        texts = [part.value if isinstance(part, ast.Constant) else None for part in node.args]
        if node.func.id in DECLARED:
            named = [part.value for part in node.keywords if part.arg in DECLARED[node.func.id]]
            for part in named:
                if isinstance(part, ast.Constant):
                    yield node.lineno, "_", part.value, []
        elif node.func.id in keywords:
            yield node.lineno, node.func.id, tuple(texts) if len(texts) != 1 else texts[0], []
        elif node.func.id.endswith("Error") and len(texts) > 1 and "." in str(texts[0]):
            yield node.lineno, "Message", tuple(texts), []


METHODS = [("**.py", from_python), ("**.j2", "jinja2")]

NAME_OF_LANGUAGE = "name of this language"
"""The text of ``tissueid.language`` that each catalogue translates by the language's own name."""
_HEADERS = ('"Language: ', '"Plural-Forms', '"MIME-', '"Content-')


def extracted() -> Catalog:
    """Return the texts of the program and of its laboratory, without translations."""
    found = Catalog(charset="utf-8", creation_date=_BEGIN, revision_date=_BEGIN, fuzzy=False)
    for package in PACKAGES:
        for _file, _line, text, _comments, _context in extract_from_dir(package, METHODS, keywords=KEYWORDS):
            found.add(text)
    return found


def paths() -> list[Path]:
    """Return the catalogues, one for each language."""
    return sorted(FOLDER.glob(f"*/{CATALOGUE}"))


def read(path: Path) -> Catalog:
    """Return the catalogue at ``path``."""
    with path.open("rb") as file:
        return read_po(file, locale=path.parents[1].name, domain="tissueid", abort_invalid=True)


def updated(path: Path, source: Catalog) -> Catalog:
    """Return the catalogue at ``path`` with exactly the texts of ``source``."""
    found = read(path)
    found.update(source, no_fuzzy_matching=True, update_creation_date=False)
    found.obsolete.clear()
    return found


def text_of(found: Catalog) -> bytes:
    """Return a catalogue as it is stored: sorted, without line numbers or dates, so that catalogues merge well."""
    for entry in found:
        entry.flags -= {"python-format", "python-brace-format"}  # Babel guesses this flag, wrongly for "3 % of"
    out = BytesIO()
    write_po(out, found, width=0, no_location=True, sort_output=True, ignore_obsolete=True)
    text = out.getvalue().decode()
    start, end = text.index('msgstr ""') + len('msgstr ""'), text.index("\n\n")
    kept = [line for line in text[start:end].splitlines() if line.startswith(_HEADERS)]
    return "\n".join([text[:start], *kept, *text[end:].split("\n")[1:]]).encode()


def untranslated(found: Catalog) -> list[str]:
    """Return the texts of a catalogue without a translation or with incomplete plural forms."""
    return [str(entry.id) for entry in found if entry.id and not _is_complete(entry)]


def _is_complete(entry: Message) -> bool:
    strings = entry.string if isinstance(entry.string, list | tuple) else (entry.string,)
    return bool(strings) and all(strings) and not entry.fuzzy


def compile_catalogue(path: Path) -> None:
    """Write the compiled form of a catalogue next to it, atomically."""
    out = BytesIO()
    write_mo(out, read(path))
    partial = path.with_suffix(f".{id(out)}.partial")
    partial.write_bytes(out.getvalue())
    partial.replace(path.with_suffix(".mo"))


def compile_stale() -> None:
    """Compile every catalogue whose compiled form is missing or older."""
    for path in paths():
        compiled = path.with_suffix(".mo")
        if not compiled.exists() or compiled.stat().st_mtime <= path.stat().st_mtime:
            compile_catalogue(path)


def problems() -> list[str]:
    """Return the problems that make catalogues incomplete or outdated, a line each."""
    source = extracted()
    used = {entry.id for entry in source if entry.id}
    lines = []
    for path in paths():
        code = path.parents[1].name
        found = read(path)
        known = {entry.id for entry in found if entry.id}
        lines += [f"{code}: not in the catalogue: {text!r}" for text in sorted(map(str, used - known))]
        lines += [f"{code}: not used by the program: {text!r}" for text in sorted(map(str, known - used))]
        lines += [f"{code}: not translated: {text!r}" for text in untranslated(found)]
    return lines


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--compile", action="store_true")
    parser.add_argument("--add", nargs=2, metavar=("CODE", "NAME"))
    options = parser.parse_args()
    if options.check:
        print(*problems(), sep="\n", end="\n" if problems() else "")
        return 1 if problems() else 0
    if options.compile:
        compile_stale()
        return 0
    source = extracted()
    if options.add:
        code, name = options.add
        path = FOLDER / code / CATALOGUE
        path.parent.mkdir(parents=True)
        new = Catalog(locale=code, header_comment=f"# {name} texts of TissueID.", fuzzy=False)
        new.add(NAME_OF_LANGUAGE, name)
        path.write_bytes(text_of(new))
    for path in paths():
        found = updated(path, source)
        path.write_bytes(text_of(found))
        compile_catalogue(path)
        print(f"{path.parents[1].name}: {len(found)} texts, {len(untranslated(found))} of them not translated")
    return 0


if __name__ == "__main__":
    sys.exit(main())
