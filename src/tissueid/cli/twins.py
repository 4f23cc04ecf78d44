"""``tissueid gap accept`` and ``tissueid twin``: twins that a diagnosis left, to be played and built upon."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from tissueid.cli.output import check_json, people_read, progress_bars, table, write_json
from tissueid.errors import UnusableInputError
from tissueid.gap import Diagnosis, crew
from tissueid.gap.named import believing, file_of
from tissueid.gap.observed import observe
from tissueid.gap.scoring import Candidate, closed, floor, gap, quiet_tests
from tissueid.gap.search import Progress, Search, applicable
from tissueid.instrument.twin_file import SUFFIX, TwinFile, check_twin_writable, read_twin, write_twin
from tissueid.sessions import read_session
from tissueid.twin.library import effect
from tissueid.wording import MISSING, number

twin = typer.Typer(help="Twins that a diagnosis left: what is in them.", no_args_is_help=True)

JsonFile = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the answer as JSON; - prints it")]
_PLAY = "simulated://"


def accepted(found: Diagnosis, name: str, session_id: str, before: TwinFile | None) -> TwinFile:
    """The twin that a diagnosis comes down to.

    Raises:
        UnusableInputError: it found no effect to accept.
    """
    if found.verdict != "effect" or found.best is None:
        said = "there is no gap" if found.verdict == "no_gap" else "no candidate explains the gap"
        raise UnusableInputError(f"nothing to accept: {said}; --effect NAME accepts one all the same")
    probability = found.ranking[0].probability if found.ranking else None
    return file_of(
        found.best,
        name,
        session_id=session_id,
        verdict=found.verdict,
        closed=found.gap.closed,
        probability=probability,
        before=before,
    )


def accept_named(
    path: Path,
    names: Sequence[str],
    twin_name: str,
    before: TwinFile | None,
    workers: int | None,
    show: Callable[[str, float], None],
) -> TwinFile:
    """Fit a session with the effects that a person names, and make a twin of it.

    Raises:
        UnusableInputError: an effect does not exist, cannot be told from these records, or leaves no trace in them.
    """
    session = read_session(path)
    observed = observe(session)
    known: tuple[str, ...] = ()
    if before is not None:
        observed, known = believing(observed, before.twin), before.twin.effects
    for name in names:
        if name in known:
            raise UnusableInputError(f"the twin has the effect {name} already")
        if not applicable(observed, effect(name)):
            raise UnusableInputError(f"these records cannot tell the effect {name}: it needs other signals")
    with crew(workers) as people:
        search = Search(observed, people, names, lambda step: show(step.what, _share(step)))
        baseline = best = search.baseline(known)
        for name in names:
            tried = Search(observed, people, [name], lambda step: show(step.what, _share(step))).partners([best])
            if not tried:
                raise UnusableInputError(f"these records hold no trace of the effect {name}")
            best = tried[0]
    return file_of(
        best, twin_name, session_id=session.session_id, verdict="by hand", closed=_closed(baseline, best), before=before
    )


def _share(step: Progress) -> float:
    return step.done / max(step.total, 1)


def _closed(baseline: Candidate, best: Candidate) -> float:
    quiet = quiet_tests(baseline.fit.parameters.observed.tests)
    return closed(gap(baseline.checked_by, quiet), gap(best.checked_by, quiet), floor(baseline.checked_by, quiet))


def accept_command(
    session: Annotated[Path, typer.Argument(metavar="SESSION", help="a session file")],
    out: Annotated[Path, typer.Option("--out", metavar="TWIN.toml", help="the twin to write")],
    effects: Annotated[
        list[str] | None, typer.Option("--effect", metavar="NAME", help="accept this one; may be repeated")
    ] = None,
    name: Annotated[str | None, typer.Option(metavar="TEXT", help="name of the twin; that of the file")] = None,
    before: Annotated[Path | None, typer.Option("--twin", metavar="FILE", help="the saved twin to build upon")] = None,
    fit: Annotated[str, typer.Option(metavar="N,...", help="tests to fit; chosen without it")] = "",
    check: Annotated[str, typer.Option(metavar="N,...", help="tests to hold out; chosen without it")] = "",
    workers: Annotated[int | None, typer.Option(min=1, max=64, metavar="N", help="processes; one a core")] = None,
    json_file: JsonFile = None,
) -> None:
    """Put what a diagnosis finds, or the effect that you name, into a twin that is saved."""
    from tissueid.cli.gap import interruptible, run_diagnose

    check_json(json_file)
    check_twin_writable(out)
    saved = None if before is None else read_twin(before)
    called = name or (saved.name if saved is not None else out.stem)
    with interruptible(), progress_bars() as show:
        if effects:
            content = accept_named(session, effects, called, saved, workers, show)
        else:
            found = run_diagnose(session, fit, check, workers, show, twin=saved)
            content = accepted(found, called, read_session(session).session_id, saved)
        write_twin(out, content)
    tell(out, content, json_file)


@twin.command("show")
def show_command(
    file: Annotated[Path, typer.Argument(metavar="TWIN.toml", help="a saved twin")], json_file: JsonFile = None
) -> None:
    """What is in a twin: figures, effects, and where it comes from."""
    check_json(json_file)
    tell(file, read_twin(file), json_file)


@twin.command("list")
def list_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="folder; this one without it")] = Path(),
    json_file: JsonFile = None,
) -> None:
    """The twins in a folder; other files are passed over."""
    check_json(json_file)
    if not folder.is_dir():
        raise UnusableInputError(f"there is no folder {folder}")
    rows = table(str(folder), "file", "name", "version", "effects", "closed", "made")
    answers = []
    for path in sorted(folder.glob(f"*{SUFFIX}")):
        try:
            content = read_twin(path)
        except UnusableInputError:
            continue
        effects = ", ".join(item.name for item in content.effects)
        share = MISSING if content.source.closed is None else f"{content.source.closed:.0%}"
        rows.add_row(path.name, content.name, str(content.version), effects, share, content.created)
        answers.append({"file": str(path), **_answer(content)})
    people = people_read(json_file)
    people.print(rows if answers else f"there are no twins in {folder}")
    if json_file is not None:
        write_json(json_file, {"twins": answers})


def tell(path: Path, content: TwinFile, json_file: Path | None) -> None:
    """Show a twin, and write it as JSON where that is asked for."""
    people = people_read(json_file)
    source = content.source
    share = "" if source.closed is None else f", closes {source.closed:.0%} of the gap"
    people.print(f"{path}: {content.name}, version {content.version}{share}", markup=False)
    if source.improves:
        people.print(f"built upon {source.improves}", markup=False)
    rows = table("Figures, SI", "part", "figure", "value", "std")
    for part, figures, prefix in (
        ("instrument", content.instrument, ""),
        ("tissue", content.tissue, "tissue_"),
        *((item.name, item.parameters, "") for item in content.effects),
    ):
        stds: dict[str, float] = next((item.stds for item in content.effects if item.name == part), content.stds)
        for figure, value in figures.items():
            std = stds.get(f"{prefix}{figure}")
            rows.add_row(part, figure, number(value), MISSING if std is None else number(std))
            part = ""
    people.print(rows)
    people.print(f"play it: tissueid test --device {_PLAY}{path.absolute()} --site TEXT --out SESSION", markup=False)
    if json_file is not None:
        write_json(json_file, {"file": str(path), **_answer(content)})


def _answer(content: TwinFile) -> dict[str, Any]:
    return content.model_dump(mode="json")


__all__ = ["accept_command", "accepted", "twin"]
