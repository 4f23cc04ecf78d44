"""Scenarios of the simulated laboratories, and their diagnosis in parallel processes.

A scenario is a JSON file of attributes and a file of little-endian 64-bit numbers, written by another process. The
labels of all scenarios are one JSON file, whose SHA-256 is published before the diagnosis. Answers survive an
interruption.

``answers/check.json`` in the folder of the scenarios holds the draw and the SHA-256 of the labels before the first
diagnosis; the answers are next to it (``tissueid.gap.answer``).
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.gap.answer import answer_path, as_answer, store_answer, stored_answer, stored_content
from tissueid.gap.dataset import Dataset, Purpose
from tissueid.gap.decision import ChannelError, floor, gap, quiet_tests
from tissueid.gap.diagnosis import diagnose
from tissueid.gap.preparation import prepare
from tissueid.gap.search import Search
from tissueid.gap.twin_export import against_twin, named_effects, twin_file_of
from tissueid.gap.workers import Executor, SerialExecutor
from tissueid.instrument.twin_file import TwinFile, read_twin, write_twin
from tissueid.sessions import Session, Test
from tissueid.version import __version__
from tissueid_lab.blind_check.scoring import Answered, BlindScore, Label, survives

_CHECK = "check"
"""Key of the description of a check in the folder of its answers."""


@dataclass(frozen=True)
class CheckInProgress:
    """A check in progress: its draw, the SHA-256 of its labels, its laboratory, whether its scenarios are on skin and
    are diagnosed against an accepted twin, and the version that answers."""

    n: int
    seed: int
    full_share: float
    seal: str
    laboratory: str = "first"
    skin: bool = False
    against_twin: bool = False
    software: str = __version__


def begin_check(folder: Path, begun: CheckInProgress) -> None:
    """Store the description of a check before its first answer; raise UnusableInputError where that fails."""
    store_answer(folder, _CHECK, asdict(begun))


def check_in_progress(folder: Path) -> CheckInProgress:
    """Return the check in progress in a folder.

    Raises:
        UnusableInputError: there is none, its file is damaged, or another version of the software began it.
    """
    content = stored_content(folder, _CHECK)
    if content is None:
        raise UnusableInputError(
            "blind.no_check", "there is no check to resume in {folder}: omit --resume to begin one", folder=str(folder)
        )
    try:
        begun = TypeAdapter(CheckInProgress).validate_python(content)
    except ValidationError as error:
        raise UnusableInputError(
            "blind.damaged_check",
            "{path} does not describe a check: begin a new one",
            path=str(answer_path(folder, _CHECK)),
        ) from error
    if begun.software != __version__:
        raise UnusableInputError(
            "blind.other_version",
            "the check in {folder} was begun by version {begun}, this is {current}: answers of two versions cannot be "
            "scored together; begin a new one",
            folder=str(folder),
            begun=begun.software,
            current=__version__,
        )
    return begun


@dataclass(frozen=True)
class BlindScenario:
    """One scenario to diagnose; ``without`` are effects removed from the library.

    With ``keep`` the answer is stored in the folder of the scenarios at once.
    """

    folder: Path
    name: str
    without: tuple[str, ...] = ()
    keep: bool = False

    @property
    def key(self) -> str:
        """Name of its stored answer."""
        return "-without-".join([self.name, *self.without])

    def answered(self) -> dict[str, Any]:
        """Return the answer, and store it where requested.

        Raises:
            UnusableInputError: it cannot be stored.
        """
        answer = self.diagnosed()
        if self.keep:
            store_answer(self.folder, self.key, answer)
        return answer

    def diagnosed(self) -> dict[str, Any]:
        """Return the JSON of ``gap diagnose`` with ``oracle`` and ``in_sample``.

        ``oracle`` is the gap that the true signals leave. ``in_sample`` is the effect that fits the fitted samples
        best, which a search without held-out data would name. For a pair ``survive_alone`` holds for each effect
        whether the session with that effect alone has a gap that survives the refit. ``accepted`` holds the effects of
        the twin of the earlier session, where there is one. ``grounds`` are those of the decision.
        """
        dataset = prepare(read_scenario(self.folder, self.name))
        earlier = earlier_session(self.folder, self.name)
        dataset, accepted = against_twin(dataset, None if earlier is None else accepted_twin(self.folder, earlier))
        diagnosis = diagnose(dataset, SerialExecutor(), accepted=accepted, without=self.without)
        singles = diagnosis.search_result.singles
        greedy = min(singles, key=lambda item: item.fit.cost, default=None)
        return as_answer(diagnosis) | {
            "accepted": list(accepted),
            "grounds": None if diagnosis.grounds is None else asdict(diagnosis.grounds),
            "oracle": _oracle(dataset, read_scenario(self.folder, self.name, "clean")),
            "in_sample": greedy.effects[-1] if greedy is not None else None,
            "survive_alone": [_survives(alone) for alone in alone_sessions(self.folder, self.name)],
        }


def accepted_twin(folder: Path, earlier: str) -> TwinFile:
    """Return the twin of an earlier session: with the effects that its diagnosis names, without any where it names
    none. It is kept in the folder of the scenarios for the other sessions of the same person.

    Raises:
        UnusableInputError: the session cannot be diagnosed, or the twin cannot be read or written.
    """
    path = folder / f"{earlier}.toml"
    if path.exists():
        return read_twin(path)
    diagnosis = diagnose(prepare(read_scenario(folder, earlier)), SerialExecutor())
    twin = named_effects(diagnosis, earlier, None).twin or twin_file_of(
        diagnosis.search_result.baseline, earlier, session_id=earlier
    )
    write_twin(path, twin)
    return twin


def answers(
    folder: Path,
    names: Sequence[str],
    pool: Executor,
    done: Callable[[object], None] = lambda _: None,
    *,
    cancelled: Callable[[], bool] = lambda: False,
    without: Mapping[str, tuple[str, ...]] | None = None,
    keep: bool = False,
) -> dict[str, dict[str, Any]]:
    """Return the answers by scenario.

    Args:
        folder: of the scenarios.
        names: of the scenarios.
        pool: processes that diagnose.
        done: called with each finished scenario.
        cancelled: whether to stop.
        without: effects removed from the library, by scenario.
        keep: store each answer in the folder of the scenarios, and reuse stored ones.

    Raises:
        UnusableInputError: a stored answer cannot be read, or one cannot be stored.
        CancelledError: ``cancelled`` returned True.
    """
    pieces = [BlindScenario(folder, name, (without or {}).get(name, ()), keep) for name in names]
    by_piece = {piece: stored_answer(folder, piece.key) if keep else None for piece in pieces}
    fresh = [piece for piece, answer in by_piece.items() if answer is None]
    for piece in pieces[: len(pieces) - len(fresh)]:
        done(piece)
    by_piece |= dict(zip(fresh, pool.do(BlindScenario.answered, fresh, cancelled, done), strict=True))
    return {piece.name: answer for piece, answer in by_piece.items() if answer is not None}


@dataclass(frozen=True)
class BlindCheck:
    """A finished blind check: its draw, a score for each kind of session, and the answer to each scenario.

    ``scores`` holds title, number of scenarios and score, by ``single`` and ``full``.
    """

    begun: CheckInProgress
    scores: dict[str, tuple[str, int, BlindScore]]
    answers: dict[str, dict[str, Any]] = field(default_factory=dict)


def with_labels(answers_by_name: dict[str, dict[str, Any]], labels: dict[str, Label]) -> list[Answered]:
    """Return answers with their labels."""
    return [Answered(name, labels[name], answer, answer.get("oracle")) for name, answer in answers_by_name.items()]


def _survives(session: Session) -> bool:
    dataset = prepare(session)
    checked = Search(dataset, SerialExecutor()).baseline().checked_by
    quiet = quiet_tests(dataset.tests)
    return survives(gap(checked, quiet), floor(checked, quiet))


def _oracle(dataset: Dataset, clean: Session) -> float:
    # The gap of the true signals without noise on the samples for the check.
    channel_errors = []
    for test in dataset.tests:
        truth = clean.test(test.number)
        for name in dataset.channels:
            mask = test.serving(Purpose.CHECK) & np.isfinite(test.signals[name]) & np.isfinite(truth.signals[name])
            if mask.any():
                error = float(np.mean((truth.signals[name][mask] - test.signals[name][mask]) ** 2))
                spread = float(np.nanstd(test.signals[name]))
                channel_errors.append(
                    ChannelError(test.number, name, error, dataset.noise[name], spread, int(mask.sum()))
                )
    return gap(channel_errors, quiet_tests(dataset.tests))


LABELS = "labels.json"
MOST_BYTES = 200_000_000


def scenario_names(folder: Path) -> list[str]:
    """Return the names of the scenarios in a folder, in order."""
    return sorted(path.stem for path in folder.glob("scenario-*.json"))


def read_scenario(folder: Path, name: str, kind: str = "") -> Session:
    """Return the session of a scenario, or a companion of this ``kind``, such as ``clean`` (the effects without noise).

    Raises:
        UnusableInputError: the files are missing or damaged.
    """
    about = _read_json(folder / f"{name}.json")
    path = folder / (f"{name}.{kind}.f64" if kind else f"{name}.f64")
    try:
        if path.stat().st_size > MOST_BYTES:
            raise UnusableInputError(f"{path} is too large for a scenario")
        numbers = np.fromfile(path, "<f8")
        names = list(about["signals"])
        tests = tuple(_test(item, names, numbers) for item in about["tests"])
        device_fields = {item.name for item in fields(DeviceDescription)}
        instrument = DeviceDescription(
            **{key: value for key, value in about["instrument"].items() if key in device_fields}
        )
    except (OSError, AttributeError, KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise UnusableInputError(f"{path} is no recording of the simulated laboratory: {error}") from error
    return Session(instrument, tests=tests)


def earlier_session(folder: Path, name: str) -> str | None:
    """Return the name of the earlier session of a scenario's person and instrument; None where there is none.

    Raises:
        UnusableInputError: the file is missing or damaged.
    """
    earlier = _read_json(folder / f"{name}.json").get("earlier")
    if earlier is None:
        return None
    if not isinstance(earlier, str) or re.fullmatch(r"earlier-\d{4,6}", earlier) is None:
        raise UnusableInputError(f"{folder / name}.json names no earlier session")
    return earlier


def alone_sessions(folder: Path, name: str) -> list[Session]:
    """Return a pair's sessions with one effect each, in the order of its effects; none where there are no companions.

    Raises:
        UnusableInputError: as ``read_scenario``.
    """
    kinds = sorted(path.name.split(".")[1] for path in folder.glob(f"{name}.alone-*.f64"))
    return [read_scenario(folder, name, kind) for kind in kinds]


def _test(about: dict[str, Any], names: list[str], numbers: np.ndarray) -> Test:
    samples, first = int(about["samples"]), int(about["first"])
    rows = numbers[first : first + samples * len(names)].reshape(len(names), samples)
    return Test(
        number=int(about["name"]),
        kind=str(about["kind"]),
        signals={name: row.copy() for name, row in zip(names, rows, strict=True)},
        sample_rate_hz=float(about["sample_rate_hz"]),
        configuration=str(about["configuration"]),
        preload_s=float(about["preload_s"]),
        surface_position_m=float(about["surface_position_m"]),
        stimulus=dict(about["stimulus"]),
        seed=int(about["seed"]),
        repeat_of=int(about["repeat_of"]) if about["repeat_of"] else None,
        notes=dict(about.get("notes", {})),
    )


def seal(folder: Path) -> str:
    """Return the SHA-256 of the labels, to be published before the diagnosis.

    Raises:
        UnusableInputError: there are no labels.
    """
    try:
        return hashlib.sha256((folder / LABELS).read_bytes()).hexdigest()
    except OSError as error:
        raise UnusableInputError(f"there are no labels in {folder}") from error


def unseal(folder: Path) -> dict[str, Label]:
    """Return the labels by scenario.

    Raises:
        UnusableInputError: they cannot be read.
    """
    try:
        return {name: _label(about) for name, about in _read_json(folder / LABELS).items()}
    except (KeyError, TypeError) as error:
        raise UnusableInputError(f"{folder / LABELS} holds no labels of scenarios") from error


def _label(about: dict[str, Any]) -> Label:
    effects = about["effects"]
    return Label(
        tuple(item["name"] for item in effects),
        tuple(item["stage"] for item in effects),
        tuple(bool(item["listed"]) for item in effects),
        bool(about["full"]),
        tuple(item["name"] for item in effects if item.get("hidden", False)),
        str(about.get("preset", "")),
    )


def _read_json(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > MOST_BYTES:
            raise UnusableInputError(f"{path} is too large for a scenario")
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise UnusableInputError(f"{path} cannot be read") from error
    if not isinstance(content, dict):
        raise UnusableInputError(f"{path} holds no object")
    return content
