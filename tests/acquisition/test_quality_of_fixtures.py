"""The quality gate on the calibration spring and on a free probe: its texts name these, not skin."""

import re
from dataclasses import replace

import numpy as np
import pytest
from acquisition.simulated_tests import DEVICE, RATE, Desk, with_signal

from tissueid.acquisition.quality import judge
from tissueid.acquisition.quality.prepared_test import SPRING
from tissueid.stimuli.base import with_preload
from tissueid.stimuli.kinds.noise import Noise

SKIN = ("skin", "tissue", "arm", "lowest force", "reference surface", "without lifting the instrument")


def found(test, earlier=()):
    return {finding.code: finding for finding in judge(test, DEVICE, earlier).findings}


def swung(tissue, low_n, high_n):
    """A test of the calibration spring, played on something, between two forces, N."""
    noise = Noise(seed=1, force_min_n=low_n, force_max_n=high_n, seconds=3.0, sample_rate=RATE)
    test = Desk(tissue, seed=3).run(with_preload(noise.build(), 0.5))
    return replace(test, kind="spring", surface_position_m=np.nan)


def test_lost_contact_with_a_spring_has_its_own_advice():
    finding = found(swung("left-posterior-forearm", -6.0, 6.0))["probe_lifted"]
    assert finding.message.template == SPRING.no_contact_force
    assert finding.advice == SPRING.contact_advice


def test_a_spring_that_is_fixed_to_the_probe_is_pulled_and_not_lost():
    assert "probe_lifted" not in found(swung("calibration-spring", -6.0, 6.0))


@pytest.mark.parametrize("kind", ["spring", "free_air"])
def test_fixtures_get_no_advice_for_skin(kind):
    desk = Desk("calibration-spring", seed=2)
    tests = [replace(desk.run(), kind=kind) for _ in range(2)]
    harmed = with_signal(tests[1], "position", tests[1].signals["position"] + 6e-4)
    knock = 9.0 * (np.arange(harmed.samples) == 3000)
    harmed = with_signal(harmed, "acceleration_y", harmed.signals["acceleration_y"] + knock)
    turn = {"gravity_along_stroke_m_s2": 9.2, "gravity_across_stroke_m_s2": 3.4}
    harmed = replace(harmed, surface_position_m=tests[0].surface_position_m + 3e-3, notes=turn)
    findings = found(harmed, tests[:1])
    random = np.random.default_rng(0).standard_normal(harmed.samples)
    findings |= found(with_signal(harmed, "position", 0.0315 - np.abs(np.cumsum(random)) * 3e-5), tests[:1])
    assert {"surface_changed", "orientation_changed", "shock", "unusual"} <= set(findings)
    if kind == "spring":
        assert {"incoherent", "end_of_stroke"} <= set(findings)
    for finding in findings.values():
        said = f"{finding.message} {finding.advice}"
        assert [word for word in SKIN if re.search(rf"\b{word}\b", said)] == [], said
