"""``tissueid quality``, and quality findings for other commands."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from tissueid.acquisition.quality import Quality, quality_of
from tissueid.cli.output import check_json, human_output, table, write_json
from tissueid.messages import Message
from tissueid.procedures.quality import QualityPlan, judge_tests
from tissueid.sessions import Session, Test

_MARKS = {"note": "note", "look": "look", "repeat": "REPEAT"}


def print_quality(plan: QualityPlan, json_file: Path | None) -> None:
    """Judge the tests of a session and print verdicts and findings.

    Raises:
        UnusableInputError: the file is not a session, or does not contain the test.
    """
    check_json(json_file)
    checked = judge_tests(plan)
    session, judged = checked.session, checked.tests
    out = human_output(json_file, width=120)
    rows = table("Quality", "test", "site", "kind", "verdict", "when it was recorded")
    for test, found in judged:
        before = quality_of(test)
        rows.add_row(
            str(test.number), test.site, test.kind, found.headline, "not judged" if before is None else before.headline
        )
    out.print(rows)
    for test, found in judged:
        for line in finding_lines(test.number, found):
            out.print(line, markup=False)
    if json_file is not None:
        answer = [_answer(test, found) for test, found in judged]
        write_json(json_file, {"session": str(plan.session), "session_id": session.session_id, "tests": answer})


def _answer(test: Test, found: Quality) -> dict[str, object]:
    before = quality_of(test)
    return {
        "test": test.number,
        "site": test.site,
        "kind": test.kind,
        **found.as_dict(),
        "verdict_when_recorded": None if before is None else before.verdict,
    }


def finding_lines(number: int, quality: Quality) -> Iterator[str]:
    """Yield the verdict on a test and its findings, one line each."""
    yield f"test {number}: {quality.headline}"
    for finding, line in zip(quality.findings, quality.lines, strict=True):
        yield f"  {_MARKS[finding.severity]}: {line}"


def recorded_findings(test: Test) -> Iterator[str]:
    """Return the findings that were recorded with a test; none if it was not judged."""
    quality = quality_of(test)
    return iter(()) if quality is None else finding_lines(test.number, quality)


def repeat_warnings(session: Session, numbers: Iterable[int]) -> Iterator[str]:
    """Yield a warning for each of these tests whose verdict was to repeat it."""
    for test in session.tests:
        quality = quality_of(test)
        if test.number in set(numbers) and quality is not None and quality.verdict == "repeat":
            worst = quality.findings[0]
            yield Message(
                "quality.advised_repeat",
                "warning: the quality check advised to repeat test {test}: {finding}",
                test=test.number,
                finding=worst.words,
            )
