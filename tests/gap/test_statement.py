"""The text of a diagnosis: codes and values, and a German translation of every statement."""

from __future__ import annotations

import itertools
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from coded import says

from tissueid.gap.diagnosis import DetectionLimit, Ranked
from tissueid.gap.next_experiment import KINDS, NextExperiment
from tissueid.gap.statement import effect_title, headline_of, next_steps_of, sentences_of
from tissueid.language import set_language
from tissueid.messages import Message, translated
from tissueid.twin.catalogue import all_effects
from tissueid.twin.effect import STAGES

ENGLISH = {"the", "and", "of", "to", "is", "it", "from", "with", "that", "most", "than", "would", "at"}


@pytest.fixture
def german():
    set_language("de")
    yield
    set_language("en")


def diagnosis(**changes: Any) -> Any:
    alike = ("dry_friction", "end_stop", "reflex")
    item = Ranked("coil_heating", "coil", 0.95, 0.4, (0.3, 0.5), alike, {})
    regions = {"bands_hz": ((3.0, 9.0), (20.0, 40.0)), "depth_m": ((1e-3, 2e-3),), "current_a": ((0.1, 0.2),)}
    regions |= {"amplitude_n": ((1.0, 2.0),), "mains_phase_rad": ((0.1, 1.0), (2.0, 3.0))}
    where = {"stage": "coil", "above_floor": True, "shares": dict.fromkeys(STAGES, 0.1) | {"coil": 0.5}}
    where["regions"] = SimpleNamespace(channel="position", direction="into", mains_hz=50.0, above=regions)
    found = {"verdict": "effect", "combination": ("coil_heating",), "ranking": (item,), "next_experiment": None}
    found["detection_limits"] = LIMITS
    found |= {
        "where": SimpleNamespace(**where),
        "conditional_odds": {},
        "budget": None,
        "at_fault": ("coil",),
        "detection_limits": LIMITS,
    } | changes
    return SimpleNamespace(**found)


LIMITS = {
    "coil_heating": DetectionLimit("heat_capacity_j_per_k", 270.0, "J/K", below=True),
    "dry_friction": DetectionLimit("coulomb_n", 0.016, "N", below=False),
    "mains_hum": None,
}


def is_german(text: str) -> bool:
    said = translated(text)
    return said != str(text) and not ENGLISH & set(said.replace(",", "").split())


def test_the_headline_holds_verdict_and_probabilities():
    headline, level = headline_of(diagnosis())
    says(headline, "gap.explained")
    assert level == "good"
    cause = headline.values["causes"].items[0].values["names"].items[0]
    assert says(cause, "gap.cause_both", effect=effect_title("coil_heating"), share="40", percent="95")
    says(headline_of(diagnosis(verdict="no_gap", combination=(), at_fault=()))[0], "gap.none")
    says(headline_of(diagnosis(verdict="unexplained", combination=()))[0], "gap.unexplained", stage="coil")
    says(headline_of(diagnosis(verdict="unexplained", combination=(), at_fault=()))[0], "gap.unexplained_nowhere")


def test_the_sentences_say_stage_regions_and_what_cannot_be_separated():
    stage, shown, alike = sentences_of(diagnosis())
    assert says(stage, "gap.stage", stage="coil", percent=50.0)
    assert says(shown, "gap.shows_most", channel="position", direction="while the probe goes in")
    codes = [part.code for part in shown.values["where"].items]
    assert codes == [f"gap.at_{what}" for what in ("frequencies", "depths", "currents", "amplitudes", "mains_phases")]
    assert says(alike, "gap.alike")
    assert alike.values["names"].items == tuple(map(effect_title, ("dry_friction", "end_stop", "reflex")))
    suspected = diagnosis(at_fault=("tissue",))
    assert says(next(sentences_of(suspected)), "gap.stage_of_cause", stage="tissue", other="coil")
    assert says(next(sentences_of(diagnosis(at_fault=("coil", "drive")))), "gap.stages")
    best = list(sentences_of(diagnosis(verdict="unexplained", combination=())))[-1]
    assert says(best, "gap.best_attempt", effect=effect_title("coil_heating"))


def test_next_steps_name_remedy_test_and_command():
    step = NextExperiment("slow_ramp", Message("gap.next_test", "Because."), ("coil_heating", "reflex"))
    remedy, test, accept = next_steps_of(diagnosis(next_experiment=step), Path("a b.h5"))
    assert remedy == all_effects()["coil_heating"].remedy
    assert says(test.values["parts"].items[0], "gap.run_separating_test", kind=KINDS["slow_ramp"])
    assert says(accept, "gap.accept_file", command="tissueid gap accept 'a b.h5' --out TWIN.toml")
    assert says(list(next_steps_of(diagnosis()))[-1], "gap.accept")
    assert says(
        next(next_steps_of(diagnosis(verdict="unexplained", combination=()))), "gap.look_at_stage", stage="coil"
    )
    assert says(next(next_steps_of(diagnosis(verdict="no_gap", combination=()))), "gap.nothing_to_do")


@pytest.mark.usefixtures("german")
def test_every_statement_is_translated():
    for one, other in itertools.pairwise(all_effects()):
        step = NextExperiment("slow_ramp", "", (one, other))
        found = diagnosis(combination=(one, other), next_experiment=step)
        assert [text for text in (headline_of(found)[0], *next_steps_of(found)) if not is_german(text)] == []
    for verdict, way in itertools.product(("effect", "unexplained", "no_gap"), ("into", "out", "both")):
        found = diagnosis(verdict=verdict, combination=("coil_heating",) if verdict == "effect" else ())
        found.where.regions.direction = way
        said = [headline_of(found)[0], *sentences_of(found), *next_steps_of(found)]
        assert [text for text in said if not is_german(text)] == []
    assert translated(list(sentences_of(diagnosis()))[1]) == (
        "Am meisten zeigt sie sich in: Position, von 3 bis 9 Hz und 20 bis 40 Hz, in Tiefen von 1 bis 2 mm, bei "
        "Strömen von 0,1 bis 0,2 A, bei einer Amplitude (der Anregung über die letzten 0,1 s) von 1 bis 2 N und bei "
        "Netzphasen (50 Hz) von 5,7 bis 57 Grad und 110 bis 170 Grad, während die Sonde hineingeht."
    )


def test_without_a_gap_the_visible_sizes_are_stated():
    (sentence,) = sentences_of(diagnosis(verdict="no_gap"))
    limits = sentence.values["limits"].items
    assert says(sentence, "gap.detection_limits")
    assert says(limits[0], "gap.limit_below", effect=effect_title("coil_heating"), size="270 J/K")
    assert says(limits[1], "gap.limit_above", effect=effect_title("dry_friction"), size="0.016 N")
    assert len(limits) == 2
