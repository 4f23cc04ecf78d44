"""Measure the sites of Table 3.1 and the variation of skin.

Without options it prints the tables; ``--write`` puts them into docs/measured/simulated-instrument.json.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from measured import replace_section

from firmware_sim.bench import Bench
from firmware_sim.presets import load_preset
from firmware_sim.tissue import Tissue
from firmware_sim.variation import Variation
from tissueid.acquisition.guided import place, play
from tissueid.acquisition.stimulus_choice import usual_noise
from tissueid.acquisition.surface_detection import CONTACT_FORCES_N
from tissueid.identification import get_engine
from tissueid.instrument import CLINICAL, join_blocks, open_instrument
from tissueid.records import Record
from tissueid.stimuli.kinds.noise import Noise

SITES = ("skin-anterior", "skin-posterior", "skin-distal")
OLDER = ("left-anterior-forearm", "left-posterior-forearm")
SEEDS = (1, 2, 3, 4)
NAMES = (
    "damping_ratio",
    "natural_frequency_rad_per_s",
    "scaled_mass_s2",
    "scaled_damping_s",
    "c1_m",
    "c2_per_n",
)
SYMBOLS = ("ζ", "ωn", "Ms", "Bs", "C1", "C2")
THESIS_SITES = {
    "skin-anterior": ("78.1", "82.6", "0.0194", "4.84", "7.42", "0.191"),
    "skin-posterior": ("86.5", "89.1", "0.0259", "5.22", "9.77", "0.154"),
    "skin-distal": ("76.1", "81.3", "0.0235", "7.00", "4.71", "0.442"),
}
INDIVIDUAL = {
    "posterior": (0.040, 0.012, 0.024, 0.039, 0.031, 0.083),
    "anterior": (0.052, 0.014, 0.028, 0.052, 0.034, 0.092),
    "mean": (0.044, 0.013, 0.025, 0.044, 0.031, 0.093),
}
POPULATION = {
    "posterior": (0.132, 0.075, 0.156, 0.123, 0.114, 0.154),
    "anterior": (0.230, 0.095, 0.170, 0.221, 0.153, 0.242),
}
MEAN_PEOPLE = (0.195, 0.077, 0.153, 0.189, 0.140, 0.226)
REST_S = 5.0
"""Time between two tests of a sitting, s."""


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def played(bench: Bench, force_n: np.ndarray, preload: int) -> Record:
    """What a bench reports of a force, N, without its preload: measured force to measured position."""
    codes = bench.block(4.0 * force_n, energised=True).codes[preload:]
    values = {c.name: c.decode(codes[:, k]) for k, c in enumerate(bench.channels)}
    return Record(3.0 * values["current"], values["position"], bench.sample_rate_hz)


def guided(bench: Bench, seed: int = 1, distribution: str = "gaussian") -> Record:
    """The default guided test, 0.5 to 10.5 N."""
    bench.begin_test()
    return played(bench, usual_noise(2000.0, seed=seed, distribution=distribution).values, 1000)


def noise(seed: int, rate_hz: float, cutoff_hz: float) -> tuple[np.ndarray, int]:
    """The force of the default guided test with a cutoff at a sample rate, N, and the samples of its preload."""
    values = (
        Noise(seed=seed, force_min_n=0.5, force_max_n=10.5, sample_rate=rate_hz, cutoff_hz=cutoff_hz).build().values
    )
    preload = round(0.5 * rate_hz)
    return np.concatenate([np.full(preload, values.mean()), values]), preload


def found_surface(bench: Bench) -> float:
    """The surface, m, by two light contacts, as the placement of a test finds it."""
    bench.begin_test()
    levels = np.array(CONTACT_FORCES_N)
    record = played(bench, np.repeat(levels - bench.nominal.gravity_force_n, 1200), 0)
    late = record.output.reshape(2, -1)[:, -400:].mean(axis=1)
    slope = (late[0] - late[1]) / (levels[0] - levels[1])
    return float(late[1] - levels[1] * slope)


def vaf(engine: str, record: Record, **options: object) -> float:
    """VAF of an engine, percent; of ``depth`` with the kernels selected by the measured depth, as in the thesis."""
    report = get_engine(engine)(**options).fit(record).report
    return report.details["vaf_scheduled_fitted_percent"] if engine == "depth" else report.vaf_percent


def six(record: Record, surface_m: float) -> np.ndarray:
    """The six parameters of thesis 7.1, shape (6,)."""
    report = get_engine("wiener")(scaling=1000.0, surface_position_m=surface_m).fit(record).report
    return np.array([report.parameters[name].value for name in NAMES])


def sites_table() -> str:
    """The sites of Table 3.1 without variation, mean of the seeds of the stimulus."""
    rows = []
    for site in (*SITES, "left-posterior-forearm"):
        records = [guided(Bench(site, seed=seed), seed) for seed in SEEDS]
        values = np.mean([six(record, 0.010) for record in records], axis=0)
        vafs = [np.mean([vaf(engine, record) for record in records]) for engine in ("lms", "wiener")]
        travel = np.mean([np.ptp(record.output) for record in records])
        cells = [f"{v:.1f}" for v in vafs]
        cells += [f"{values[2]:.4f}", f"{values[3]:.2f}", f"{1e3 * values[4]:.2f}", f"{values[5]:.3f}"]
        wanted = THESIS_SITES.get(site)
        shown = [f"{c} ({w})" for c, w in zip(cells, wanted, strict=True)] if wanted else cells
        rows.append([site, *shown, f"{1e3 * travel:.1f}"])
    head = ["preset (thesis)", "linear VAF %", "Wiener VAF %", "Ms s²", "Bs s", "C1 mm", "C2 1/N", "travel mm"]
    return table(head, rows)


TECHNIQUES: tuple[tuple[str, str, dict[str, object]], ...] = (
    ("linear", "lms", {}),
    ("Wiener", "wiener", {}),
    ("depth, 7 partitions", "depth", {"correct": False}),
    ("second-order Volterra, every third sample", "volterra", {"method": "exact", "downsample": 3}),
)


def techniques_table() -> str:
    """The four techniques of Table 8.1 in the default guided test."""
    rows = []
    for site in (*SITES, "left-posterior-forearm"):
        for distribution in ("gaussian", "uniform"):
            records = [guided(Bench(site, seed=seed), seed, distribution) for seed in SEEDS[:2]]
            cells = [np.mean([vaf(name, r, **options) for r in records]) for _, name, options in TECHNIQUES]
            rows.append([site, distribution, *(f"{cell:.1f}" for cell in cells)])
    rows.append(["thesis, Table 8.1", "", "70 to 75", "75 to 80", "90 to 95", "90 to 97"])
    return table(["preset", "noise", *(title for title, _, _ in TECHNIQUES)], rows)


def changed(tissue: Tissue) -> dict[str, Tissue]:
    """A tissue without one of its features each."""
    older = load_preset("left-posterior-forearm")
    return {
        "as it is": tissue,
        "damping alike in both directions": replace(tissue, direction_ratio=0.0),
        "directions parted as in left-posterior-forearm": replace(
            tissue,
            direction_ratio=older.direction_ratio,
            direction_speed_m_per_s=older.direction_speed_m_per_s,
        ),
        "damping alike at every depth": replace(
            tissue,
            damping=replace(tissue.damping, coefficient=tissue.damping.at(0.006), rate_per_m=0.0),
        ),
        "no relaxation": tissue.with_extras(tissue.extras - {"relaxation"}),
    }


def features_table() -> str:
    """Which feature takes the VAF down while the probe stays on the skin."""
    rows = []
    for site in SITES:
        for title, tissue in changed(load_preset(site)).items():
            records = [guided(Bench(tissue, seed=seed), seed) for seed in SEEDS[:2]]
            cells = [np.mean([vaf(engine, r) for r in records]) for engine in ("lms", "wiener")]
            rows.append([site, title, *(f"{cell:.1f}" for cell in cells)])
    return table(["preset", "feature", "linear VAF %", "Wiener VAF %"], rows)


def cutoff_table() -> str:
    """K, B and M at equal depths with 50 Hz at 500 Hz relative to 200 Hz at 2 kHz (Fig. 5.10)."""
    rows = []
    relaxing = {site: load_preset(site) for site in (*SITES, "skin-anterior-relaxing", *OLDER[1:])}
    for site in SITES:
        tissue = load_preset(site)
        relaxing[f"{site}, no relaxation"] = tissue.with_extras(tissue.extras - {"relaxation"})
    for title, tissue in relaxing.items():
        ratios = []
        for seed in range(1, 9):
            profiles = []
            for rate_hz, cutoff_hz in ((2000.0, 200.0), (500.0, 50.0)):
                force_n, preload = noise(seed, rate_hz, cutoff_hz)
                record = played(Bench(tissue, seed=seed, sample_rate_hz=rate_hz), force_n, preload)
                profiles.append(get_engine("depth")(correct=False).fit(record).local)
            if any(profile is None for profile in profiles):
                continue
            low = max(np.nanmin(profile.position) for profile in profiles)
            high = min(np.nanmax(profile.position) for profile in profiles)
            at = np.linspace(low, high, 5)
            fast, slow = (
                np.array([np.interp(at, p.position, getattr(p, name)) for name in ("stiffness", "damping", "mass")])
                for p in profiles
            )
            ratios.append(np.nanmean(np.log(slow / fast), axis=1))
        middle, error = np.mean(ratios, axis=0), np.std(ratios, axis=0, ddof=1) / np.sqrt(len(ratios))
        cells = [f"{np.exp(m):.2f} ± {np.exp(m) * e:.2f}" for m, e in zip(middle, error, strict=True)]
        rows.append([title, *cells])
    rows.append(["thesis, Fig. 5.10", "above 1 (no figure)", "about 1", "about 1"])
    return table(["tissue", "K, 50 Hz over 200 Hz", "B", "M"], rows)


@cache
def sittings(site: str, subjects: int) -> np.ndarray:
    """Six parameters and the linear VAF of five tests of each subject, shape (subjects, 5, 7).

    The surface is found before each test, as by one command for each test.
    """
    people = []
    for subject in range(1, subjects + 1):
        bench = Bench(site, seed=subject, variation=Variation(subject, 1.0, subject))
        tests = []
        for _ in range(5):
            surface_m = found_surface(bench)
            record = guided(bench)
            tests.append([*six(record, surface_m), vaf("lms", record)])
            bench.block(np.zeros(round(REST_S * 2000.0)), energised=False)
        people.append(tests)
    return np.array(people)


def _against(values: np.ndarray, thesis: Sequence[float] | None) -> list[str]:
    return [f"{v:.3f}" + (f" ({t:.3f})" if thesis else "") for v, t in zip(values, thesis or values, strict=True)]


def region(site: str) -> str:
    """The site of Tables 7.1 and 7.2 to compare a preset with."""
    return "anterior" if "anterior" in site else "posterior" if "posterior" in site else ""


def individual_table(subjects: int) -> str:
    """Coefficients of variation within a sitting, mean over subjects (Table 7.1)."""
    rows, all_sites = [], []
    for site in (*SITES, *OLDER):
        values = sittings(site, subjects)[:, :, :6]
        spread = (values.std(axis=1, ddof=1) / values.mean(axis=1)).mean(axis=0)
        if site in SITES[:2]:
            all_sites.append(spread)
        rows.append([site, *_against(spread, INDIVIDUAL.get(region(site)))])
    rows.append(["mean of skin-anterior and skin-posterior", *_against(np.mean(all_sites, axis=0), INDIVIDUAL["mean"])])
    return table(["preset (thesis)", *SYMBOLS], rows)


def population_table(subjects: int) -> str:
    """Coefficients of variation between subjects' means (Table 7.2)."""
    rows = []
    for site in (*SITES, *OLDER):
        means = sittings(site, subjects)[:, :, :6].mean(axis=1)
        spread = means.std(axis=0, ddof=1) / means.mean(axis=0)
        rows.append([site, *_against(spread, POPULATION.get(region(site)))])
    return table(["preset (thesis)", *SYMBOLS], rows)


def first_table(subjects: int) -> str:
    """Mean of the later tests less the first, over subjects (Fig. 7.4)."""
    rows = []
    for site in (*SITES, *OLDER):
        values = sittings(site, subjects)
        shift = values[:, 1:, :6].mean(axis=1) - values[:, 0, :6]
        relative = 100.0 * shift / values[:, :, :6].mean(axis=1)
        cells = [
            f"{m:+.1f} ± {s:.1f}" for m, s in zip(relative.mean(axis=0), relative.std(axis=0, ddof=1), strict=True)
        ]
        in_mm = f"{1e3 * shift[:, 4].mean():+.2f} ± {1e3 * shift[:, 4].std(ddof=1):.2f}"
        rows.append([site, *cells, in_mm, f"{values[:, :, 6].mean():.1f}"])
    return table(["preset", *(f"{s} %" for s in SYMBOLS), "C1 mm", "linear VAF %"], rows)


def in_process_table(subjects: int) -> str:
    """Sittings with the in-process simulation, by its address with subject and variation."""
    volts = 4.0 * usual_noise(2000.0).values
    people = []
    for subject in range(subjects):
        instrument = open_instrument(f"simulated://forearm?seed={subject}&subject={subject}&variation=1")
        tests = []
        for _ in range(5):
            surface_m = place(instrument).surface_m
            blocks: list[np.ndarray] = []
            play(instrument, volts, CLINICAL, on_samples=lambda samples, _, kept=blocks: kept.append(samples))
            samples = join_blocks(blocks)[1000 : volts.size]
            record = Record(3.0 * samples["current"], samples["position"], 2000.0)
            tests.append([*six(record, surface_m), vaf("lms", record)])
        people.append(tests)
    values = np.array(people)
    means = values[:, :, :6].mean(axis=1)
    within = (values[:, :, :6].std(axis=1, ddof=1) / means).mean(axis=0)
    shift = 1e3 * (values[:, 1:, 4].mean(axis=1) - values[:, 0, 4])
    rows = [
        ["within a sitting (mean row of Table 7.1)", *_against(within, INDIVIDUAL["mean"])],
        [
            "between subjects (mean row of Table 7.2)",
            *_against(means.std(axis=0, ddof=1) / means.mean(axis=0), MEAN_PEOPLE),
        ],
    ]
    return (
        table(["`simulated://forearm` (thesis)", *SYMBOLS], rows)
        + f"\n\nC1 of tests 2 to 5 less the first: {shift.mean():+.2f} ± {shift.std(ddof=1):.2f} mm; linear VAF "
        f"{values[:, :, 6].mean():.1f} %."
    )


TABLES: dict[str, Callable[[int], str]] = {
    "skin sites": lambda _: sites_table(),
    "skin techniques": lambda _: techniques_table(),
    "skin features": lambda _: features_table(),
    "skin cutoff": lambda _: cutoff_table(),
    "skin repeats": individual_table,
    "skin people": population_table,
    "skin first test": first_table,
    "skin in process": in_process_table,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables, or write them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="put the tables into the data")
    parser.add_argument("--only", choices=sorted(TABLES), action="append", help="make only this table")
    parser.add_argument("--subjects", type=int, default=16, help="number of people for the tables of variation")
    options = parser.parse_args(arguments)
    for name in options.only or TABLES:
        made = TABLES[name](options.subjects)
        print(f"\n{name}\n\n{made}", flush=True)
        if options.write:
            replace_section("simulated-instrument", name, text=made)


if __name__ == "__main__":
    main()
