"""A protocol gives the steps of a sitting; a sitting on the simulator is complete, continues and stores values."""

import io
import json
import zlib

import pytest
from coded import coded
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from tissueid.cli import main
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.procedures import study_subjects
from tissueid.procedures.control import Control
from tissueid.procedures.study_plans import SUBJECTS_FILE
from tissueid.procedures.study_protocol import (
    PROTOCOL_FILE,
    Condition,
    Protocol,
    RecordedTest,
    check_pseudonym,
    finished_sites,
    next_step,
    parse_protocol,
    protocol_text,
    read_protocol,
    sitting_steps,
    template,
)
from tissueid.procedures.study_sitting import SittingRunPlan, condition_of, open_sitting, run_sitting
from tissueid.procedures.study_subjects import (
    add_photograph,
    missing_demographics,
    read_demographics,
    save_demographics,
)
from tissueid.studies.study_table import read_subjects

LOTION = Condition(product="lotion", minutes_since_application=60.0)
QUICK = {"name": "Quick", "sites": ["left calf", {"site": "abdomen", "repeats": 1}], "repeats": 2, "seconds": 0.5}


def two_products(**values):
    given = {"name": "x", "sites": ["a", "b", "c"], "repeats": 2, "conditions": [{}, LOTION.model_dump()]}
    return parse_protocol(given | values, "protocol")


def order(protocol, subject):
    return [(step.condition.product, step.site) for step in sitting_steps(protocol, subject) if step.repeat == 1]


def recorded(site, condition=Condition(), counts=True):  # noqa: B008 - frozen
    return RecordedTest(site, condition, counts)


def put(folder, values):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / PROTOCOL_FILE).write_text(json.dumps(values), encoding="utf-8")
    return folder


# -- the order of a sitting ---------------------------------------------------------------------------------------


def test_steps_go_by_condition_then_site_then_repeat():
    steps = sitting_steps(two_products(), "P01")
    assert order(two_products(), "P01") == [(product, site) for product in ("", "lotion") for site in "abc"]
    assert [(step.position, step.total) for step in steps] == [(place, 12) for place in range(1, 13)]
    assert [step.repeat for step in steps[:4]] == [1, 2, 1, 2]


def test_a_random_order_depends_on_the_subject_and_keeps_products_in_order():
    protocol = two_products(order="randomised")
    orders = {subject: tuple(order(protocol, subject)) for subject in ("P01", "P02", "P03", "P04")}
    assert len(set(orders.values())) > 1
    assert orders["P01"] == tuple(order(two_products(order="randomised"), "P01"))
    assert orders["P01"] != tuple(order(two_products(order="randomised", seed=1), "P01"))
    for found in orders.values():
        assert [product for product, _site in found] == [""] * 3 + ["lotion"] * 3
        assert {site for _product, site in found} == set("abc")


def test_the_order_of_a_subject_is_that_of_every_version():
    assert order(two_products(order="randomised"), "P02")[:3] == [("", "c"), ("", "b"), ("", "a")]


def test_the_next_step_follows_what_was_recorded():
    protocol = two_products()
    assert next_step(protocol, "P", []) == sitting_steps(protocol, "P")[0]
    step = next_step(protocol, "P", [recorded("a"), recorded("a"), recorded("b")])
    assert (step.site, step.repeat, step.position, step.attempt) == ("b", 2, 4, 1)
    assert finished_sites(protocol, "P", step) == {"a"}
    assert finished_sites(protocol, "P", sitting_steps(protocol, "P")[6]) == set()  # the lotion begins
    everything = [recorded(one.site, one.condition) for one in sitting_steps(protocol, "P")]
    assert next_step(protocol, "P", everything) is None
    assert finished_sites(protocol, "P", None) == set("abc")


def test_sites_measured_out_of_order_are_not_asked_again():
    step = next_step(two_products(), "P", [recorded("c"), recorded("c"), recorded("a")])
    assert (step.site, step.repeat, step.position) == ("a", 2, 2)
    step = next_step(two_products(), "P", [recorded(site) for site in "ccaabb"])
    assert step.condition == LOTION


def test_spaces_around_names_do_not_keep_a_sitting_from_going_on():
    protocol = two_products(sites=[" a "], repeats=1, conditions=[{"product": "lotion "}])
    assert next_step(protocol, "P", [recorded("a", Condition(product="lotion"))]) is None


def test_a_test_of_no_use_is_asked_again_a_few_times():
    protocol = two_products(attempts=2)
    step = next_step(protocol, "P", [recorded("a", counts=False)])
    assert (step.site, step.repeat, step.attempt) == ("a", 1, 2)
    step = next_step(protocol, "P", [recorded("a", counts=False), recorded("a", counts=False)])
    assert (step.site, step.repeat, step.attempt) == ("a", 2, 1)


def test_minutes_need_not_be_those_of_the_protocol():
    late = Condition(product="lotion", minutes_since_application=200.0)
    protocol = two_products(sites=["a"], repeats=1, conditions=[{}, LOTION.model_dump(), late.model_dump()])
    tests = [recorded("a"), recorded("a", Condition(product="lotion", minutes_since_application=63.5))]
    assert next_step(protocol, "P", tests).condition == late
    assert next_step(protocol, "P", [recorded("a", Condition(product="oil"))]).position == 1


# -- files --------------------------------------------------------------------------------------------------------


def test_a_template_is_read_again(tmp_path):
    assert main(["study", "protocol", str(tmp_path / "s"), "--json", str(tmp_path / "a.json")]) == 0
    assert read_protocol(tmp_path / "s") == template()
    assert json.loads((tmp_path / "a.json").read_text())["tests"] == 20
    assert main(["study", "protocol", str(tmp_path / "s")]) == 0
    one = parse_protocol(QUICK, "p")
    assert parse_protocol(json.loads(protocol_text(one)), "p") == one


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"sites": []}, "protocol.no_site"),
        ({"sites": ["a", "a"]}, "protocol.twice"),
        ({"sites": ["a\tb"]}, "protocol.text"),
        ({"sites": [" "]}, "protocol.empty"),
        ({"conditions": []}, "protocol.no_condition"),
        ({"conditions": [{"minutes_since_application": 3}]}, "protocol.minutes"),
        ({"stimulus": "loud"}, "protocol.stimulus"),
        ({"repeats": 100, "sites": [f"s{place}" for place in range(101)]}, "protocol.long"),
    ],
)
def test_a_protocol_that_cannot_be_used_is_refused(changes, code):
    with pytest.raises(UnusableInputError) as refused:
        parse_protocol(QUICK | changes, "p.json")
    assert refused.value.message.code == "protocol.refused"
    assert refused.value.message.values["reason"].code == code
    assert str(refused.value).startswith("p.json: ")
    assert any(f"'{name}'" in str(refused.value) for name in changes) or code == "protocol.twice"
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "changes", [{"repeats": 0}, {"demographics": ["name"]}, {"sitess": 1}, {"order": "any"}, {"sites": 3}]
)
def test_values_of_a_protocol_are_checked(changes):
    with pytest.raises(UnusableInputError, match=r"p\.json"):
        parse_protocol(QUICK | changes, "p.json")


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("[", "protocol.not_json"),
        ("[1]", "protocol.no_object"),
        (json.dumps(QUICK | {"conditions": [{"orientation_deg": 0.0}]}), "protocol.refused"),
        (json.dumps(QUICK | {"limits": "none"}), "protocol.refused"),
        (json.dumps(QUICK | {"probe": "spoon"}), "protocol.refused"),
    ],
)
def test_a_file_that_is_no_protocol_is_refused(tmp_path, text, code):
    (tmp_path / PROTOCOL_FILE).write_text(text)
    with pytest.raises(UnusableInputError, check=coded(code)):
        read_protocol(tmp_path)
    assert main(["study", "protocol", str(tmp_path)]) == 2


def test_a_folder_without_a_protocol_says_how_to_get_one(tmp_path):
    with pytest.raises(UnusableInputError, check=coded("protocol.none")):
        read_protocol(tmp_path)


@pytest.mark.parametrize(
    "text", ["John Smith", "a@b.org", "", "..", "../P1", "P" * 41, "Jürgen", "P1.", "Results", "Hans.Mueller"]
)
def test_a_name_is_no_pseudonym(text):
    with pytest.raises(UnusableInputError, check=coded("protocol.pseudonym")):
        check_pseudonym(text)


def test_pseudonyms():
    assert [check_pseudonym(text) for text in ("P01", " P-001 ", "a_1.b", "P 1")] == ["P01", "P-001", "a_1.b", "P 1"]


# -- demographic values and photographs ---------------------------------------------------------------------------


def test_demographic_values_are_kept_with_those_of_others(tmp_path):
    (tmp_path / SUBJECTS_FILE).write_text("subject,centre,age_years\nP02,Boston,40\n", encoding="utf-8-sig")
    save_demographics(tmp_path, "P01", {"age_years": "30", "height_m": "1,7", "gender": "female", "ethnicity": ""})
    save_demographics(tmp_path, "P01", {"weight_kg": "60.50"})
    rows = read_demographics(tmp_path)
    assert rows["P02"]["centre"] == "Boston"
    assert rows["P01"]["height_m"] == "1.7"
    assert rows["P01"]["weight_kg"] == "60.5"
    table = read_subjects(tmp_path / SUBJECTS_FILE).set_index("subject")
    assert table.loc["P01", "age_years"] == 30
    assert table.loc["P02", "age_years"] == 40
    assert missing_demographics(template(), tmp_path, "P01") == ["handedness"]
    assert missing_demographics(template(), tmp_path, "P03") == list(template().demographics)


@pytest.mark.parametrize(
    ("name", "text", "code"),
    [
        ("age_years", "300", "subjects.range"),
        ("height_m", "170", "subjects.range"),
        ("weight_kg", "heavy", "subjects.range"),
        ("gender", "m", "subjects.choice"),
        ("skin_conditions", "ask a@b.org", "subjects.text"),
        ("ethnicity", "=1+1", "subjects.text"),
        ("name", "John", "subjects.unknown"),
    ],
)
def test_impossible_demographic_values_are_refused(tmp_path, name, text, code):
    with pytest.raises(UnusableInputError, check=coded(code)):
        save_demographics(tmp_path, "P01", {name: text})
    assert not (tmp_path / SUBJECTS_FILE).exists()


def test_a_damaged_file_of_subjects_is_not_replaced(tmp_path):
    for text, code in (("who\nP01\n", "study.subjects_column"), ("subject\nP1\nP1\n", "study.subjects_twice")):
        (tmp_path / SUBJECTS_FILE).write_text(text)
        with pytest.raises(UnusableInputError, check=coded(code)):
            save_demographics(tmp_path, "P01", {"age_years": "30"})
        assert (tmp_path / SUBJECTS_FILE).read_text() == text


def picture(kind, **options):
    """A red picture of 8 x 4 pixels with a blue left half."""
    made, file = Image.new("RGB", (8, 4), "red"), io.BytesIO()
    made.paste("blue", (0, 0, 4, 4))
    made.save(file, kind, **options)
    return file.getvalue()


def test_photographs_are_copied_upright_and_without_descriptions(tmp_path):
    described, turned = PngInfo(), Image.Exif()
    described.add_text("Author", "John Smith")
    turned[0x0112], turned[0x013B] = 6, "John Smith"  # to be turned by 90 degrees; artist
    (tmp_path / "a.png").write_bytes(picture("PNG", pnginfo=described))
    (tmp_path / "b.jpg").write_bytes(picture("JPEG", exif=turned, comment="John Smith"))
    found = add_photograph(tmp_path / "s", "P01", "left forearm, posterior", tmp_path / "a.png")
    assert found.relative_to(tmp_path / "s").as_posix() == "photographs/P01 left-forearm--posterior.png"
    assert add_photograph(tmp_path / "s", "P01", "left forearm, posterior", tmp_path / "a.png") != found
    upright = add_photograph(tmp_path / "s", "P01", "arm", tmp_path / "b.jpg")
    for path in (found, upright):
        assert b"John Smith" not in path.read_bytes()
    with Image.open(found) as same, Image.open(upright) as other:
        assert (same.size, same.getpixel((0, 0)), same.getpixel((7, 0))) == ((8, 4), (0, 0, 255), (255, 0, 0))
        assert (other.size, other.getexif()) == ((4, 8), {})
        assert other.getpixel((0, 0))[2] > 200 > 100 > other.getpixel((0, 7))[2]


CUT_OFF = picture("PNG")[:50], picture("JPEG")[:40]


@pytest.mark.parametrize("data", [b"", b"\xff\xd8", b"GIF89a", *CUT_OFF, picture("GIF")])
def test_what_is_no_photograph_is_refused(tmp_path, data):
    (tmp_path / "a.jpg").write_bytes(data)
    with pytest.raises(UnusableInputError, check=coded("photograph.kind")):
        add_photograph(tmp_path / "s", "P01", "arm", tmp_path / "a.jpg")
    assert not (tmp_path / "s").exists()


def with_density(numbers):
    """Return a PNG picture whose physical size has other bytes, and a checksum that is right."""
    png = picture("PNG", dpi=(72, 72))
    at = png.index(b"pHYs")
    length = int.from_bytes(png[at - 4 : at], "big")
    chunk = b"pHYs" + numbers
    size = len(numbers).to_bytes(4, "big")
    return png[: at - 4] + size + chunk + zlib.crc32(chunk).to_bytes(4, "big") + png[at + length + 8 :]


def with_resolution_as_bytes():
    """Return a JPEG picture whose description has a resolution of the wrong type."""
    described = Image.Exif()
    described[0x0112], described[0x011A] = 6, 72.5
    return picture("JPEG", exif=described).replace(b"\x01\x1a\x00\x05", b"\x01\x1a\x00\x01")


@pytest.mark.parametrize("data", [with_density(b""), with_density(bytes(3)), with_resolution_as_bytes()])
def test_a_photograph_with_damaged_descriptions_is_refused(tmp_path, data):
    (tmp_path / "a.jpg").write_bytes(data)
    with pytest.raises(UnusableInputError, check=coded("photograph.kind")):
        add_photograph(tmp_path / "s", "P01", "arm", tmp_path / "a.jpg")
    assert not (tmp_path / "s").exists()


def test_a_photograph_with_too_many_pixels_is_made_smaller_or_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(study_subjects, "_MOST_PIXELS", 20)
    (tmp_path / "a.jpg").write_bytes(picture("JPEG"))
    with Image.open(add_photograph(tmp_path / "s", "P01", "arm", tmp_path / "a.jpg")) as smaller:
        assert smaller.size == (4, 2)
    for kind, options in (("PNG", {}), ("JPEG", {"progressive": True})):
        (tmp_path / "a.jpg").write_bytes(picture(kind, **options))
        with pytest.raises(UnusableInputError, check=coded("photograph.kind")):
            add_photograph(tmp_path / "s", "P01", "arm", tmp_path / "a.jpg")


# -- a whole sitting ----------------------------------------------------------------------------------------------


class Until(Control):
    """Cancels a sitting after some steps."""

    def __init__(self, steps):
        self.left, self.notices, self.texts = steps, [], []

    def progress(self, fraction, step):
        self.texts.append(str(step))
        self.left -= 1

    def notice(self, message):
        self.notices.append(message)

    def cancelled(self):
        return self.left < 0


def sitting(folder, **values):
    return SittingRunPlan(folder=folder, subject="P01", url="simulated://forearm?seed=1", calibration=False, **values)


def test_a_sitting_that_was_interrupted_continues(tmp_path):
    folder = put(tmp_path / "s", QUICK)
    control = Until(2)
    with pytest.raises(CancelledError):
        run_sitting(sitting(folder, values=("age_years=30",)), control, None)
    assert [notice.code for notice in control.notices if notice.code == "sitting.demographics"]
    assert read_demographics(folder)["P01"]["age_years"] == "30"
    stopped = open_sitting(folder, "P01")
    assert stopped.step.position == 3
    (stopped.sessions / "damaged.h5").write_bytes(b"rubbish")
    control = Until(99)
    state = run_sitting(sitting(folder), control, None)
    assert state.step is None
    assert "sitting.unreadable" in [notice.code for notice in control.notices]
    assert control.texts[0] == "Sitting of P01: 2 of 3"
    assert [test.site for test in state.tests if test.counts] == ["left calf", "left calf", "abdomen"]
    assert len(list(state.sessions.glob("P01-*.h5"))) == len(state.tests)


def test_condition_of_damaged_notes():
    assert condition_of({"condition": "x", "minutes_since_application": -5.0, "orientation_deg": "no"}) == Condition(
        product="x"
    )


def test_only_the_simulator_is_measured_without_a_person(tmp_path, capsys):
    folder = put(tmp_path / "s", QUICK)
    command = ["study", "sitting", str(folder), "--subject", "P01", "--device"]
    assert main([*command, "/dev/ttyACM0"]) == 2
    assert main([*command, "simulated://forearm", "--photograph", "knee=x.png"]) == 2
    assert main([*command, "simulated://forearm", "--value", "age_years"]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 3
    assert not list(folder.glob("P01/*"))


def test_a_protocol_knows_its_plan(tmp_path):
    protocol = Protocol(**(QUICK | {"conditions": (LOTION,), "stimulus": "thesis"}))
    plan = protocol.plan(sitting_steps(protocol, "P01")[0], "simulated://forearm", tmp_path / "a.h5")
    assert (plan.condition, plan.minutes_since_application, plan.min_force_n) == ("lotion", 60.0, -5.0)
    assert plan.as_notes()["condition"] == "lotion"


def test_the_command_says_where_the_sitting_stands(tmp_path, capsys):
    folder = put(tmp_path / "s", QUICK | {"sites": ["abdomen"], "repeats": 1, "demographics": ["gender"]})
    command = ["study", "sitting", str(folder), "--subject", "P01", "--device", "simulated://forearm?seed=1"]
    assert main([*command, "--value", "gender=female", "--json", str(tmp_path / "a.json")]) == 0
    answer = json.loads((tmp_path / "a.json").read_text())
    assert (answer["steps"], answer["done"], answer["problems"]) == (1, 1, {})
    assert [test["site"] for test in answer["tests"] if test["counts"]] == ["abdomen"]
    assert "P01: 1 of 1 steps done" in capsys.readouterr().out
    assert read_demographics(folder)["P01"]["gender"] == "female"
