"""``tissueid twin`` and what ``tissueid gap accept`` refuses."""

import json

import pytest
import tomli_w
from shell import complaint

from tissueid.cli import main
from tissueid.twin.bus import MOST_EFFECTS
from tissueid.twin.catalogue import all_effects
from tissueid.twin.chain_parameters import InstrumentParameters, Tissue

TWIN = {
    "format": "tissueid-twin",
    "format_version": "1.0",
    "name": "arm",
    "version": 3,
    "sample_rate_hz": 2000.0,
    "source": {"closed": 0.97},
    "instrument": vars(InstrumentParameters()),
    "tissue": vars(Tissue()),
    "effects": [{"name": "reluctance_force", "parameters": {}}],
}
TOO_MANY = [word for name in list(all_effects())[: MOST_EFFECTS + 1] for word in ("--effect", name)]


@pytest.fixture
def twin(tmp_path):
    from tissueid.twin.catalogue import effect

    known = effect("reluctance_force")
    TWIN["effects"][0]["parameters"] = {
        parameter.name: value for parameter, value in zip(known.parameters, known.starts[0], strict=True)
    }
    path = tmp_path / "arm.toml"
    path.write_text(tomli_w.dumps(TWIN), encoding="utf-8")
    return path


def test_show_says_what_is_in_it(twin, tmp_path, capsys):
    out = tmp_path / "answer.json"
    assert main(["twin", "show", str(twin), "--json", str(out)]) == 0
    answer = json.loads(out.read_text())
    assert answer["name"] == "arm"
    assert answer["effects"][0]["name"] == "reluctance_force"
    assert "simulated:" in capsys.readouterr().out


def test_list_passes_over_what_is_no_twin(twin, tmp_path):
    (tmp_path / "other.toml").write_text("a = 1\n")
    out = tmp_path / "answer.json"
    assert main(["twin", "list", str(tmp_path), "--json", str(out)]) == 0
    assert [item["version"] for item in json.loads(out.read_text())["twins"]] == [3]


def test_a_saved_twin_is_an_instrument(twin, tmp_path):
    out = tmp_path / "s.h5"
    arguments = ["--site", "arm", "--seconds", "0.5", "--no-calibration", "--out", str(out)]
    assert main(["test", "--device", f"simulated://{twin}?seed=2", *arguments]) == 0
    assert out.exists()


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["gap", "accept", "SESSION", "--out", "FOLDER/no/a.toml"], "no folder"),
        (["gap", "accept", "SESSION", "--out", "FOLDER/a.txt"], "must end in .toml: a.txt"),
        (["gap", "accept", "SESSION", "--out", "FOLDER/a.toml", "--effect", "luck"], "no such file"),
        (["gap", "accept", "SESSION", "--out", "FOLDER/a.toml", *(2 * ["--effect", "latency"])], "is named twice"),
        (
            ["gap", "accept", "SESSION", "--out", "FOLDER/a.toml", *TOO_MANY],
            f"at most {MOST_EFFECTS} effects, not {MOST_EFFECTS + 1}",
        ),
        (
            ["gap", "accept", "SESSION", "--out", "FOLDER/a.toml", "--effect", "latency", "--fit", "one"],
            "--fit must be",
        ),
        (["gap", "accept", "SESSION", "--out", "FOLDER/a.toml", "--json", "FOLDER/a.toml"], "named for two outputs"),
        (["gap", "diagnose", "SESSION", "--out", "FOLDER/a", "--json", "FOLDER/a"], "named for two outputs"),
        (["gap", "diagnose", "SESSION", "--twin", "FOLDER/none.toml"], "cannot read"),
        (["twin", "show", "FOLDER/none.toml"], "cannot read"),
        (["twin", "list", "FOLDER/none"], "no folder"),
        (["test", "--device", "simulated://FOLDER/none.toml", "--site", "x", "--out", "FOLDER/a.h5"], "cannot read"),
    ],
)
def test_wrong_use_ends_in_one_line(arguments, reason, tmp_path, capsys):
    words = [word.replace("FOLDER", str(tmp_path)).replace("SESSION", str(tmp_path / "s.h5")) for word in arguments]
    assert reason in complaint(capsys, *words)
