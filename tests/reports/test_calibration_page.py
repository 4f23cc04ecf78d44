"""The page of a dynamic sweep, from a calibration that was made up."""

import numpy as np
import pytest
from coded import coded, shows
from coded import made as message_of
from golden.golden_page import check_golden_page, lines_of_html
from reports.in_german import english_in, in_german, shown, texts_of
from reports.page_check import checked

from tissueid.calibration import CalibratedQuantity, Calibration
from tissueid.errors import UnusableInputError
from tissueid.reports.calibration_page import NO_RESPONSES, sweep_report
from tissueid.units import display_unit

PLACES = 1e-3 * np.arange(2, 31, 4)
GRID = np.linspace(2e-3, 30e-3, 57)


def constant(position):
    return 3.0 - 0.6 / (1.0 + np.exp((28e-3 - np.asarray(position)) / 1.5e-3))


def made(repeats: int = 0, verdict: str = "passed", **without: bool) -> Calibration:
    believed = 3.0 / constant(PLACES)
    hz = np.geomspace(2.0, 200.0, 21)
    compliance = 1.0 / np.abs(1000.0 - 0.066 * (2 * np.pi * hz) ** 2 + 3.6j * 2 * np.pi * hz)
    tables = {
        "sweep": {
            "position_m": PLACES,
            "vaf_percent": np.linspace(99.9, 97.0, PLACES.size),
            "mass_kg": 0.066 * believed,
            "mass_std_kg": 1e-4 * believed,
            "damping_n_s_per_m": 3.6 * believed,
            "damping_std_n_s_per_m": 0.01 * believed,
            "stiffness_n_per_m": 1000.0 * believed,
            "stiffness_std_n_per_m": 3.0 * believed,
            "force_constant_n_per_a": constant(PLACES),
            "force_constant_std_n_per_a": 0.01 * believed,
        },
        "force_constant": {
            "position_m": GRID,
            "value_n_per_a": constant(GRID),
            "std_n_per_a": np.full(GRID.size, 0.015),
            "by_spring_n_per_a": 1.002 * constant(GRID),
            "by_spring_std_n_per_a": np.full(GRID.size, 0.001),
            "by_flux_n_per_a": 0.99 * constant(GRID),
            "by_flux_std_n_per_a": np.full(GRID.size, 0.03),
        },
        "response": {
            "position_m": np.repeat(PLACES, hz.size),
            "frequency_hz": np.tile(hz, PLACES.size),
            "compliance_m_per_n": np.outer(constant(PLACES) / 3.0, compliance).ravel(),
            "phase_rad": np.tile(np.linspace(0.0, -np.pi, hz.size), PLACES.size),
        },
    }
    if repeats:
        tables["repeats"] = {
            "run": np.arange(1, repeats + 1),
            "force_constant_n_per_a": 3.0 + 1e-3 * np.arange(repeats),
            "linear_region_min_m": 2e-3 + 1e-5 * np.arange(repeats),
            "linear_region_max_m": 25e-3 + 1e-5 * np.arange(repeats),
            "moving_mass_kg": np.full(repeats, 0.06),
        }
    tables = {name: columns for name, columns in tables.items() if not without.get(name)}
    figures = {
        "force_constant_n_per_a": CalibratedQuantity(value=2.99, std=0.015, unit="N/A"),
        "linear_region_min_m": CalibratedQuantity(value=2e-3, std=1e-4, unit="m"),
        "linear_region_max_m": CalibratedQuantity(value=25.1e-3, std=1e-4, unit="m"),
        "spring_over_flux": CalibratedQuantity(value=1.002, std=0.003),
    }
    return Calibration(
        kind="sweep",
        model="<desktop> indenter",
        serial_number="D-7",
        date="2026-03-01T09:30:00Z",
        software="tissueid test",
        conditions={"seconds": 4.0, "note_1": "they agree & <well>"},
        verdict=verdict,
        problems=() if verdict == "passed" else ("the channels' scales disagree",),
        quantities={name: item for name, item in figures.items() if not without.get(name)},
        tables={
            name: {key: tuple(map(float, values)) for key, values in columns.items()}
            for name, columns in tables.items()
        },
    )


def test_the_page_is_whole_and_says_what_was_found():
    page = checked(sweep_report(made()).html())
    assert shows(
        page.text, "calibration.sweep.headline", low=2.0, high=25.1, verdict=message_of("calibration.verdict.passed")
    )
    assert "they agree & <well>" in page.text
    assert "<desktop> indenter, D-7" in page.text
    for heading in ("The coil by position", "Force constant along the stroke", "Bode diagrams by position"):
        assert heading in page.text
    assert len(page.named("svg")) == 3


def test_the_thesis_stands_beside_what_was_found(undrawn):
    page = checked(sweep_report(made()).html())
    for cell in ("95 to 98", "60 to 80", "3 to 4", "1000 to 1200", "100 to 7000"):
        assert cell in page.text
    assert "1000 to 1004" in page.text  # within the linear region


def test_newton_per_ampere_is_not_written_as_not_available(undrawn):
    text = checked(sweep_report(made(repeats=3)).html()).text
    assert "N per A" in text
    assert "N/A" not in text
    assert display_unit("N/A") == ("N per A", 1.0)


def test_repeats_get_a_table_and_a_figure(undrawn):
    page = checked(sweep_report(made(repeats=10)).html())
    assert "Repeatability over 10 sweeps" in page.text
    assert len(page.named("svg")) == 4


def test_a_failed_one_says_why(undrawn):
    report = sweep_report(made(verdict="failed"))
    assert report.level == "poor"
    assert "the channels' scales disagree" in checked(report.html()).text


def test_a_coil_the_wrong_way_round_gets_a_page_as_well():
    whole = made(verdict="failed", response=True)
    turned = {
        table: {
            name: tuple(-value for value in values) if name.endswith(("n_per_a", "n_per_m", "_kg")) else values
            for name, values in columns.items()
        }
        for table, columns in whole.tables.items()
    }
    page = checked(sweep_report(whole.model_copy(update={"tables": turned})).html())
    assert len(page.named("svg")) == 2


def test_without_responses_the_other_figures_are_there():
    page = checked(sweep_report(made(response=True)).html())
    assert str(NO_RESPONSES) in page.text
    assert len(page.named("svg")) == 2


@pytest.mark.parametrize("lacking", ["sweep", "force_constant", "linear_region_min_m"])
def test_what_is_no_sweep_is_refused(lacking):
    with pytest.raises(UnusableInputError, check=coded("report.sweep_incomplete")):
        sweep_report(made(**{lacking: True}))


def test_another_kind_is_refused():
    with pytest.raises(UnusableInputError, check=coded("report.not_a_sweep", kind="static")):
        sweep_report(made().model_copy(update={"kind": "static"}))


def test_the_page_of_a_sweep_says_nothing_in_english(undrawn):
    sweep = made(repeats=3, verdict="failed").model_copy(update={"problems": ()})
    texts = in_german(lambda: shown(sweep_report(sweep).html()))
    drawn = in_german(lambda: [text for panel in sweep_report(sweep).panels for text in texts_of(panel.picture())])
    assert english_in(texts + drawn, (sweep.model, sweep.software, sweep.conditions["note_1"])) == []


def test_all_of_it_goes_on_one_sheet(tmp_path):
    path = tmp_path / "sweep.png"
    sweep_report(made(repeats=3)).write(path)
    assert path.read_bytes().startswith(b"\x89PNG")


def test_the_report_of_a_sweep_reads_as_its_golden_page(undrawn):
    """Renew the page by ``python tests/golden/renew.py``."""
    check_golden_page("report-calibration", lines_of_html(sweep_report(made(repeats=3)).html()))
