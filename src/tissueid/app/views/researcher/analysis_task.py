"""The task of an analysis: engines, options, signals, their preparation, and tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from tissueid.app.views.researcher.selected_test import SelectedTest, ShortText
from tissueid.identification import Engine, get_engine
from tissueid.stored_values import Name

if TYPE_CHECKING:  # takes long to import
    from tissueid.analysis.split import Selection

MOST_TESTS = 5000

Value = None | bool | int | float | ShortText | Annotated[list[float], Field(max_length=200)]


class _Specification(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Preparation(_Specification):
    """What is done to the signals before a fit, and whether mass and damping of the tissue alone are reported."""

    detrend: bool = False
    low_hz: Annotated[float | None, Field(gt=0.0)] = None
    high_hz: Annotated[float | None, Field(gt=0.0)] = None
    tissue_alone: bool = False

    @property
    def without_actuator(self) -> Preparation:
        """The same for a comparison, which reports no parameters of the tissue alone."""
        return self.model_copy(update={"tissue_alone": False})

    @property
    def changed(self) -> dict[str, Any]:
        """What differs from the defaults, by name."""
        return self.model_dump(exclude_defaults=True)


AS_RECORDED = Preparation()


class AnalysisTask(_Specification):
    """One run. A comparison has several ``engines`` with default options.

    ``together`` fits the tests of one file together; otherwise each is fitted by itself.
    """

    kind: Literal["run", "compare"] = "run"
    engines: Annotated[tuple[Name, ...], Field(min_length=1, max_length=100)]
    options: Annotated[dict[Name, Value], Field(max_length=60)] = {}
    input_name: Name = "force"
    output_name: Name = "position"
    preparation: Preparation = AS_RECORDED
    together: bool = False
    tests: Annotated[tuple[SelectedTest, ...], Field(max_length=MOST_TESTS)] = ()

    @property
    def groups(self) -> list[tuple[SelectedTest, ...]]:
        """Groups of tests that are fitted together, in the order of selection."""
        chosen = list(dict.fromkeys(self.tests))
        if not self.together:
            return [(test,) for test in chosen]
        by_file: dict[Path, list[SelectedTest]] = {}
        for test in chosen:
            by_file.setdefault(test.path, []).append(test)
        return [tuple(tests) for tests in by_file.values()]

    def selection(self, group: Sequence[SelectedTest]) -> Selection:
        """Return tests and signals of a group for an analysis or a comparison."""
        first, *others = group
        return {
            "test": first.number,
            "also": [test.number for test in others],
            "input_name": self.input_name,
            "output_name": self.output_name,
            "detrend": self.preparation.detrend,
            "band_hz": (self.preparation.low_hz, self.preparation.high_hz),
        }

    def specification(self) -> Engine:
        """Return the engine with its options.

        Raises:
            UnusableInputError: there is no such engine, or an option is not one that it takes.
        """
        options: dict[str, Any] = dict(self.options)
        return get_engine(self.engines[0]).from_options(options)
