"""What the simulator says of scenarios: what there is, and where to read on."""

import tomllib

import pytest

from firmware_sim.__main__ import main
from firmware_sim.effects import LISTED
from firmware_sim.scenario import Scenario


def test_help_shows_a_scenario_that_can_be_used(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    text = capsys.readouterr().out
    assert "docs/simulated-instrument.md" in text
    example = text.partition("docs/simulated-instrument.md:\n")[2]
    (effect,) = Scenario.model_validate(tomllib.loads(example)).acting
    assert effect.name == "dry_friction"


@pytest.mark.parametrize(
    ("scenario", "names"),
    [
        ("[effects.dry_fiction]\nlevel = 0.3\n", LISTED),
        ("[effects.dry_friction]\nlevle = 0.3\n", ("level",)),
        ("[effect.dry_friction]\nlevel = 0.3\n", ("effects", "faults", "preset")),
    ],
)
def test_a_wrong_name_lists_those_that_there_are(scenario, names, tmp_path, capsys):
    path = tmp_path / "scenario.toml"
    path.write_text(scenario)
    assert main(["--scenario", str(path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "there are: " in line
    assert all(name in line.partition("there are: ")[2] for name in names)
