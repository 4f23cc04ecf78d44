"""Build the documentation site: every page of the project, and the reference from docstrings and argument parsers.

    .venv/bin/python tools/build_docs.py                 # `make docs`: docs/_build/html/index.html
    .venv/bin/python tools/build_docs.py --out FOLDER

The build needs no network, and fails on a warning, a dead link, or anything that a page would fetch from elsewhere.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import measured_pages
from make_package import ROOT, problem

_MEASURED = re.compile(r"\]\(((?:\.\./)*(?:docs/)?measured/[\w-]+)\.json\)")
"""Links to data of measured figures, which lead to the pages made from them."""
_KEPT = ("*.md", "*.png", "*.svg", "*.json", "*.cff", "LICENSE")


def stage(source: Path) -> None:
    """Copy the pages and their pictures to ``source``, where links between them stay as they are; add the reference."""
    for folder in ("docs", "calibration_data"):
        for pattern in _KEPT:
            for path in (ROOT / folder).rglob(pattern):
                if "_build" not in path.parts:
                    _copy(path, source / path.relative_to(ROOT))
    for path in (path for pattern in _KEPT for path in ROOT.glob(pattern)):
        _copy(path, source / path.name)
    for path in measured_pages.FOLDER.glob("*.json"):
        (source / "docs" / "measured" / f"{path.stem}.md").write_text(measured_pages.as_page(path), encoding="utf-8")
    for path in source.rglob("*.md"):
        text = path.read_text(encoding="utf-8")
        path.write_text(_MEASURED.sub(r"](\1.md)", text), encoding="utf-8")
    for name in ("conf.py", "site.css"):
        _copy(ROOT / "docs" / "site" / name, source / name)
    reference = source / "reference"
    reference.mkdir()
    for name, text in references().items():
        (reference / f"{name}.md").write_text(text, encoding="utf-8")
    index = (source / "docs" / "site" / "index.md").read_text(encoding="utf-8")
    shutil.rmtree(source / "docs" / "site")
    listed = set(re.findall(r"^(?:.* <)?([\w./-]+)>?$", index, re.MULTILINE))
    pages = sorted(str(path.relative_to(source).with_suffix("")) for path in source.rglob("*.md"))
    further = "\n".join(page for page in pages if page not in listed and not page.startswith("docs/decisions/0"))
    decisions = "\n".join(page for page in pages if page.startswith("docs/decisions/0"))
    index += f"\n```{{toctree}}\n:caption: Further pages\n:hidden:\n\n{further}\n```\n" if further else ""
    (source / "index.md").write_text(index, encoding="utf-8")
    with (source / "docs" / "decisions" / "README.md").open("a", encoding="utf-8") as file:
        toc = decisions.replace("docs/decisions/", "")
        file.write(f"\n```{{toctree}}\n:hidden:\n\n{toc}\n```\n")


def _copy(path: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(path, target)


PLUG_IN_FUNCTIONS = (
    "tissueid.identification.engine",
    "tissueid.identification.aic",
    "tissueid.identification.aicc",
    "tissueid.identification.preparation.prepare",
    "tissueid.stimuli.stimulus",
    "tissueid.language.marked",
)
PLUG_IN_CLASSES = (
    "tissueid.identification.Family",
    "tissueid.identification.FitReport",
    "tissueid.identification.LineFigure",
    "tissueid.identification.FittedCurve",
    "tissueid.identification.preparation.PreparedRecord",
    "tissueid.stimuli.OpenLoopKind",
    "tissueid.twin.effect.Parameter",
    "tissueid.twin.effect.Readings",
    "tissueid.messages.Message",
)
_EFFECTS = """# Effects

The effects that a diagnosis can name, in the order of the signal chain. `tissueid gap effects` prints the same list.
"""


def references() -> dict[str, str]:
    """Return the generated pages by name: the Python interface, the commands, engines, stimuli and effects."""
    import tissueid
    from tissueid.cli.command_reference import manual_markdown

    engines, stimuli = tissueid.list_engines(), tissueid.list_stimuli()
    effects = [_effect(effect) for effect in tissueid.list_effects().values()]
    return {
        "python": _python_page(),
        "commands": manual_markdown(),
        "engines": _options_page("Options of the engines", "tissueid engines NAME", engines),
        "stimuli": _options_page("Options of the stimuli", "tissueid stimulus KIND --options", stimuli),
        "effects": "\n".join([_EFFECTS, *effects]),
    }


def _python_page() -> str:
    import inspect

    import tissueid

    names = [name for name in tissueid.__all__ if name != "__version__"]
    functions = [name for name in names if inspect.isfunction(getattr(tissueid, name))]
    lines = ["# Python reference", "", "The names of `import tissueid`, from their docstrings.", "", "## Functions", ""]
    lines += ["```{eval-rst}", ".. currentmodule:: tissueid", ""]
    lines += [f".. autofunction:: tissueid.{name}" for name in functions]
    lines += ["```", "", "## Classes", "", "```{eval-rst}"]
    for name in (name for name in names if name not in functions):
        lines += [
            f".. autoclass:: tissueid.{name}",
            "   :members:",
            "   :exclude-members: model_config, __init__, __new__",
            "",
        ]
    lines += ["```", "", "## For plug-ins", "", "What the how-to pages import in addition.", "", "```{eval-rst}"]
    lines += [f".. autofunction:: {name}" for name in PLUG_IN_FUNCTIONS]
    for name in PLUG_IN_CLASSES:
        lines += [f".. autoclass:: {name}", "   :members:", "   :exclude-members: model_config", ""]
    return "\n".join([*lines, "```", ""])


def _options_page(title: str, command: str, kinds: dict[str, type]) -> str:
    lines = [f"# {title}", "", f"From their declarations. `{command}` prints the same.", ""]
    for name, kind in kinds.items():
        lines += [f"## `{name}`", "", _plain(str(kind.title or (kind.__doc__ or "").split("\n\n")[0])), ""]
        lines += ["| option | default | bounds | |", "| --- | --- | --- | --- |"]
        for option, field in kind.model_fields.items():
            default = "required" if field.is_required() else repr(field.get_default(call_default_factory=True))
            lines.append(f"| `{option}` | `{default}` | {_bounds(field)} | {_plain(field.description or '')} |")
        lines.append("")
    return "\n".join(lines)


def _bounds(field: object) -> str:
    words = {"ge": "≥", "gt": "&gt;", "le": "≤", "lt": "&lt;"}
    found = [
        f"{sign} {getattr(item, name):g}"
        for item in field.metadata
        for name, sign in words.items()
        if isinstance(getattr(item, name, None), int | float)
    ]
    return ", ".join(found)


def _effect(effect: object) -> str:
    lines = [f"## `{effect.name}`", "", f"{_plain(effect.title)} (stage: {effect.stage}).", ""]
    parts = {
        "Equation": effect.equation,
        "Signature": effect.signature,
        "Source": effect.source,
        "Mistaken for": ", ".join(effect.mistaken_for),
        "Remedy": effect.remedy,
    }
    lines += [f"- **{name}:** {_plain(text)}" for name, text in parts.items() if text]
    lines += ["", "| parameter | unit | vanishes at | bounds | |", "| --- | --- | --- | --- | --- |"]
    for item in effect.parameters:
        neutral = "" if item.neutral is None else f"{item.neutral:g}"
        lines.append(
            f"| `{item.name}` | {item.unit} | {neutral} | {item.low:g} to {item.high:g} | {_plain(item.meaning)} |"
        )
    return "\n".join([*lines, ""])


def _plain(text: str) -> str:
    """Return a text in one line, in which Markdown finds no markup."""
    return "".join(f"\\{sign}" if sign in "\\`*_<>[]|#" else sign for sign in " ".join(text.split()))


class _Page(HTMLParser):
    """Targets and anchors of a page of the site."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self.anchors: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what an element links to, fetches and is named."""
        given = dict(attrs)
        self.anchors.update(filter(None, (given.get("id"), given.get("name"))))
        if tag == "a" and given.get("href"):
            self.links.append(str(given["href"]))
        for name in ("src", "srcset", "data"):
            if given.get(name):
                self.fetched.append(str(given[name]))
        if tag == "link" and given.get("rel") in ("stylesheet", "icon", "preload", "shortcut icon"):
            self.fetched.append(str(given.get("href")))


def problems(site: Path) -> list[str]:
    """Return dead links, dead anchors and addresses that pages of the site would fetch, a line each."""
    pages: dict[Path, _Page] = {}
    for path in site.rglob("*.html"):
        pages[path.resolve()] = _Page()
        pages[path.resolve()].feed(path.read_text(encoding="utf-8"))
    found = []
    for path, page in pages.items():
        name = path.relative_to(site.resolve())
        found += [f"{name} fetches {target}" for target in page.fetched if re.match(r"(?:[a-z]+:)?//", target)]
        inside = [target for target in page.links if not re.match(r"[a-z]+:", target)]
        for target in [*inside, *(target for target in page.fetched if not re.match(r"(?:[a-z]+:|//)", target))]:
            file, _, anchor = unquote(target).partition("#")
            place = (path.parent / file.partition("?")[0]).resolve() if file else path
            if not place.exists():
                found.append(f"{name}: there is no {target}")
            elif anchor and place in pages and anchor not in pages[place].anchors:
                found.append(f"{name}: {target} has no such anchor")
    return found


def main() -> int:
    """Build and check; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "_build" / "html", metavar="FOLDER")
    out = parser.parse_args().out
    if reason := problem("sphinx", out, "docs") or problem("myst_parser", out, "docs"):
        print(f"docs: {reason}", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(prefix="tissueid-docs-") as folder:
        source, made, doctrees = (Path(folder) / name for name in ("source", "html", "doctrees"))
        source.mkdir()
        stage(source)
        command = [
            sys.executable,
            "-m",
            "sphinx",
            "-q",
            "-W",
            "--keep-going",
            "-b",
            "html",
            "-d",
            doctrees,
            source,
            made,
        ]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, map(str, sys.path)))}
        done = subprocess.run(command, env=environment, check=False)
        if done.returncode:
            return 1
        if found := problems(made):
            print(*found, sep="\n", file=sys.stderr)
            return 1
        shutil.rmtree(out)
        shutil.copytree(made, out)
    print(f"{sum(1 for _ in out.rglob('*.html'))} pages: open {out / 'index.html'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
