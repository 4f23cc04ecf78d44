"""Stored results and diagnoses of earlier days are read with the values that were stored."""

import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from coded import says

from tissueid.app.views.gap.diagnosis_result import keep, read_kept
from tissueid.app.views.researcher.engine_outcome import read_results, write_results
from tissueid.gap.diagnosis_plots import overlay_plots, profile_plot, spectrum_plot

KEPT = Path(__file__).parents[2] / "golden" / "kept"


@pytest.fixture
def diagnoses(tmp_path):
    for path in KEPT.glob("2*.json"):
        shutil.copy(path, tmp_path)
    return tmp_path


def stored_lines():
    return [json.loads(line) for line in (KEPT / "results.jsonl").read_text().splitlines()]


def same(value, stored):
    return math.isnan(value) if stored is None else value == stored


def test_results_are_read_with_the_stored_values():
    kept = read_results(KEPT / "results.jsonl")
    assert (len(kept.outcomes), kept.bad) == (5, 0)
    for outcome, line in zip(kept.outcomes, stored_lines(), strict=True):
        assert (outcome.engine, outcome.options, outcome.refused) == (line["engine"], line["options"], line["refused"])
        assert (list(outcome.signals), outcome.recommended) == (line["signals"], line["recommended"])
        assert [(str(test.path), test.number, test.when) for test in outcome.tests] == [
            (test["path"], test["number"], test["when"]) for test in line["tests"]
        ]
        assert (outcome.preparation.detrend, outcome.preparation.high_hz) == (
            line["preparation"]["detrend"],
            line["preparation"]["high_hz"],
        )
        assert [str(text) for text in outcome.findings] == line["findings"]
        assert outcome.changed == (line["stamp"] is not None)
        stored, report = line["report"], outcome.report
        if stored is None:
            assert report is None
            continue
        assert (report.n_samples, report.n_parameters, report.model) == (
            stored["n_samples"], stored["n_parameters"], stored["model"],
        )  # fmt: skip
        assert same(report.vaf_percent, stored["vaf_percent"])
        for name in ("vaf_validation_percent", "validation_p_value", "vaf_scheduled_percent", "aic", "aicc", "seconds"):
            assert getattr(report, name) == stored[name]
        for name, (value, std) in stored["parameters"].items():
            assert same(report.parameters[name].value, value)
            assert report.parameters[name].std == std
        assert all(same(report.details[name], value) for name, value in stored["details"].items())
        for name in ("warnings", "findings"):
            assert [str(text) for text in getattr(report, name)] == stored[name]
            messages = zip(getattr(report, name), stored["messages"][name], strict=True)
            assert all(text.as_dict() == message for text, message in messages if message is not None)


def test_results_are_written_so_that_they_are_read_again(tmp_path):
    first = read_results(KEPT / "results.jsonl").outcomes
    write_results(tmp_path / "results.jsonl", first)
    again = read_results(tmp_path / "results.jsonl").outcomes
    for new, old in zip(again, first, strict=True):
        assert (new.key, new.validated_on, new.findings, new.refused) == (
            old.key, old.validated_on, old.findings, old.refused,
        )  # fmt: skip
        assert (new.stamp, new.plots.units) == (old.stamp, old.plots.units)
        assert (new.report and new.report.as_dict()) == (old.report and old.report.as_dict())


def test_diagnoses_are_read_with_the_stored_values(diagnoses):
    kept = read_kept(diagnoses)
    assert ([result.story.verdict for result in kept.results], kept.bad) == (["no_gap", "effect"], 0)
    for result in kept.results:
        stored = json.loads((KEPT / f"{result.key}.json").read_text())
        story = result.story
        assert result.answer == stored["answer"]
        assert (str(result.asked.session), result.asked.fit) == ("/data/friction.h5", (1,))
        assert list(result.stamp) == stored["stamp"]
        assert result.instrument.force_constant_n_per_a == stored["instrument"]["force_constant_n_per_a"]
        assert [(item.stage, item.share, item.lit) for item in story.stages] == [
            (item["stage"], item["share"], item["lit"]) for item in stored["story"]["stages"]
        ]
        assert [(row.low, row.high, row.role) for row in story.budget] == [
            (row["low"], row["high"], row["role"]) for row in stored["story"]["budget"]
        ]
    effect = kept.results[1]
    assert says(effect.story.headline, "gap.explained")
    assert effect.accepted.effects[0].name == "dry_friction"
    ranking = json.loads((KEPT / f"{effect.key}.json").read_text())["story"]["ranking"]
    assert [item.probability for item in effect.story.ranking] == [item["probability"] for item in ranking]
    assert [item.figures[0].value.value for item in effect.story.ranking] == [
        item["figures"][0]["value"]["value"] for item in ranking
    ]


def test_curves_of_a_stored_diagnosis_are_drawn_with_the_stored_values(diagnoses):
    for result in read_kept(diagnoses).results:
        stored = json.loads((KEPT / f"{result.key}.json").read_text())["story"]
        spectrum = spectrum_plot(result.story.spectrum)
        lines = np.array([stored["spectrum"]["frequency"], *stored["spectrum"]["lines"].values()], dtype=np.float64)
        curves = [curve for curve in spectrum.curves if curve.kind != "spans"]
        np.testing.assert_array_equal(curves[0].x, 10.0 ** lines[0])
        order = [list(stored["spectrum"]["lines"]).index(name) for name in ("recorded", "residual", "linear")]
        np.testing.assert_array_equal([curve.y for curve in curves[:3]], 10.0 ** lines[1:][order])
        for name, profile in stored["profiles"].items():
            drawn = profile_plot(name, result.story.profiles[name]).curves[1]
            np.testing.assert_array_equal(drawn.x, profile["middle"])
            np.testing.assert_array_equal(drawn.y, 10.0 ** np.array(profile["error"]))
        for overlay, shown in zip(result.story.overlays, stored["overlays"], strict=True):
            recorded, left = overlay_plots(overlay)
            np.testing.assert_array_equal(recorded.curves[0].y, shown["recorded"])
            np.testing.assert_array_equal(left.curves[0].y, shown["left_before"])


def test_a_stored_diagnosis_is_written_so_that_it_is_read_again(diagnoses, tmp_path):
    for result in read_kept(diagnoses).results:
        keep(result, tmp_path / "again")
    again = read_kept(tmp_path / "again").results
    assert [item.answer for item in again] == [item.answer for item in read_kept(diagnoses).results]
    spectra = [
        [item.story.spectrum.lines["recorded"] for item in read_kept(folder).results]
        for folder in (diagnoses, tmp_path / "again")
    ]
    np.testing.assert_array_equal(*spectra)
