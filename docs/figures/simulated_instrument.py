"""Measure the simulated instrument; write docs/measured/simulated-instrument.json and a picture.

Without options it prints the tables; ``--write`` puts them, and the picture, into the data.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import matplotlib
import numpy as np
from measured import replace_section

from firmware_sim.bench import Bench
from firmware_sim.coil import finite_coil, profile_values
from firmware_sim.device_models import MODELS
from firmware_sim.local_values import local_values
from firmware_sim.plant import SAMPLE_RATE_HZ, SUBSTEPS, Plant, PlantParameters
from firmware_sim.presets import load_preset, preset_names
from firmware_sim.tissue import Tissue
from tissueid.identification import get_engine
from tissueid.records import Record
from tissueid.stimuli.kinds.noise import Noise

matplotlib.use("Agg")
from matplotlib import pyplot as plt

HERE = Path(__file__).parent
PICTURE = HERE / "simulated-instrument.png"
# What slides along the forearm is held by an external spring: nothing in the thesis to compare it with.
SKIN = tuple(name for name in preset_names() if name.endswith("arm") and not name.startswith("sliding"))
# The sites of Table 3.1 are measured by skin_variation.py.
MATERIALS = tuple(name for name in preset_names() if name not in SKIN and not name.startswith("skin-"))
RANGES_N = {"gaussian": (-5.0, 12.0), "uniform": (-3.5, 10.5)}
PRELOAD = 1000
SEEDS = tuple(range(1, 9))
FEW_SEEDS = SEEDS[:3]
COMPARED = ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m")
THESIS_VAF = {
    "left-posterior-forearm": "75.8 / 80.7 (3.3); 86.5 / 89.1 (Table 3.1)",
    "right-posterior-forearm": "86.5 / 89.1 (Table 3.1, left)",
    "left-anterior-forearm": "78.1 / 82.6 (Table 3.1)",
    "right-anterior-forearm": "78.1 / 82.6 (Table 3.1, left)",
    "left-distal-forearm": "76.1 / 81.3 (Table 3.1)",
    "upper-arm": "none given",
}


def force(kind: str, seed: int, mean_n: float = 3.5) -> np.ndarray:
    """Preload and noise, N, shape (9000,): gaussian or uniform standard test, or small about ``mean_n``."""
    if kind == "small":
        noise = Noise(seed=seed, force_min_n=mean_n - 0.75, force_max_n=mean_n + 0.75)
    else:
        low, high = RANGES_N[kind]
        noise = Noise(distribution=kind, seed=seed, force_min_n=low, force_max_n=high, clipped=0.0455)
    values = noise.build().values
    return np.concatenate([np.full(PRELOAD, values.mean()), values])


@cache
def measured(tissue: Tissue, kind: str, seed: int, mean_n: float = 3.5) -> Record:
    """What the bench reports of one test: measured force to measured position, preload cut off."""
    bench = Bench(tissue, seed=seed)
    codes = bench.block(4.0 * force(kind, seed, mean_n), energised=True).codes[PRELOAD:]
    values = {c.name: c.decode(codes[:, k]) for k, c in enumerate(bench.channels)}
    return Record(3.0 * values["current"], values["position"], SAMPLE_RATE_HZ)


def fit(engine: str, record: Record) -> tuple[float, dict[str, float]]:
    """VAF in percent and parameters."""
    report = get_engine(engine)().fit(record).report
    return report.vaf_percent, {name: value.value for name, value in report.parameters.items()}


def lifted_percent(tissue: Tissue, kind: str, seed: int) -> float:
    """Share of a test, percent, in which the probe is off the tissue."""
    touching = Plant(PlantParameters(), tissue).advance(4.0 * force(kind, seed))["touching"]
    return 100.0 * float(1.0 - touching[PRELOAD:].mean())


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def spread(values: Sequence[float], form: str = ".1f") -> str:
    """Least to greatest, or the one value."""
    low, high = (format(v, form) for v in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def standard_table() -> str:
    """The standard test: linear and Wiener VAF."""
    rows = []
    for name in SKIN:
        tissue = load_preset(name)
        cells = [name]
        for kind in RANGES_N:
            linear, wiener = ([fit(e, measured(tissue, kind, s))[0] for s in SEEDS] for e in ("lms", "wiener"))
            gains = [w - v for v, w in zip(linear, wiener, strict=True)]
            cells += [spread(linear), spread(wiener), spread(gains)]
        rows.append([*cells, THESIS_VAF[name]])
    head = ["preset"]
    head += [f"{kind}: {what}" for kind in RANGES_N for what in ("linear VAF %", "Wiener VAF %", "points gained")]
    return table([*head, "thesis, linear / Wiener"], rows)


def averages_table() -> str:
    """The standard test: average mass, damping and stiffness, and where the probe goes."""
    rows = []
    for name in SKIN:
        tissue = load_preset(name)
        records = [measured(tissue, "gaussian", s) for s in SEEDS]
        fits = [fit("lms", record)[1] for record in records]
        mean = {key: float(np.mean([f[key] for f in fits])) for key in COMPARED}
        where = np.array([[r.output.min(), r.output.max(), r.output.mean()] for r in records]).mean(axis=0) * 1e3
        rows.append(
            [
                name,
                f"{1e3 * mean['mass_kg']:.0f}",
                f"{mean['damping_n_s_per_m']:.1f}",
                f"{mean['stiffness_n_per_m']:.0f}",
                f"{where[0]:.1f} to {where[1]:.1f}",
                f"{where[1] - where[0]:.1f}",
                f"{np.mean([lifted_percent(tissue, 'gaussian', s) for s in SEEDS]):.1f}",
            ]
        )
    thesis = "thesis 3.1.3, left posterior | 91 | 22.8 | 4670 | 10 to 17 (Fig. 3.8) | about 7 | not given"
    rows.append(thesis.split(" | "))
    head = ["preset", "mass g", "damping N s/m", "stiffness N/m", "position mm", "travel mm", "lifted off %"]
    return table(head, rows)


def small_table() -> str:
    """Small tests against the plant's own values."""
    rows = []
    for name in SKIN:
        for mean_n in (3.5, 4.5):
            record = measured(load_preset(name), "small", 2, mean_n)
            vaf, found = fit("lms", record)
            truth = local_values(name, float(record.output.mean()))
            cells = [name, f"{mean_n:g} ± 0.75", f"{vaf:.1f}", f"{1e3 * truth['depth_m']:.2f}"]
            for key, scale in zip(COMPARED, (1e3, 1.0, 1.0), strict=True):
                off = 100.0 * (found[key] / truth[key] - 1.0)
                cells.append(f"{scale * found[key]:.4g} ({off:+.1f} %)")
            rows.append(cells)
    head = ["preset", "force N", "linear VAF %", "depth mm", "mass g", "damping N s/m", "stiffness N/m"]
    return table(head, rows)


def ablation_table() -> str:
    """The standard test with extras switched off and on one by one."""
    rows = []
    for name in SKIN:
        tissue = load_preset(name)
        sets = {"all on": tissue.extras} | {f"no {e}": tissue.extras - {e} for e in sorted(tissue.extras)}
        sets |= {f"only {e}": frozenset([e]) for e in sorted(tissue.extras)} | {"all off": frozenset()}
        for label, extras in sets.items():
            changed = tissue.with_extras(extras)
            linear, wiener = (
                float(np.mean([fit(e, measured(changed, "gaussian", s))[0] for s in FEW_SEEDS]))
                for e in ("lms", "wiener")
            )
            small = fit("lms", measured(changed, "small", 2))[0]
            rows.append([name, label, f"{linear:.1f}", f"{wiener:.1f}", f"{small:.1f}"])
    return table(["preset", "extras", "linear VAF %", "Wiener VAF %", "small test, linear VAF %"], rows)


def materials_table() -> str:
    """Everything that is not skin."""
    rows = []
    for name in MATERIALS:
        tissue = load_preset(name)
        small = fit("lms", measured(tissue, "small", 2))
        large = measured(tissue, "gaussian", 1)
        mass, damping, stiffness = (small[1][key] for key in COMPARED)
        cells = [name, f"{small[0]:.1f}", f"{1e3 * mass:.0f}", f"{damping:.1f}", f"{stiffness:.0f}"]
        cells += [f"{fit(engine, large)[0]:.1f}" for engine in ("lms", "wiener")]
        rows.append([*cells, f"{1e3 * np.ptp(large.output):.1f}"])
    head = ["preset", "small: linear VAF %", "mass g", "damping N s/m", "stiffness N/m"]
    return table([*head, "large: linear VAF %", "large: Wiener VAF %", "travel mm"], rows)


def step_table() -> str:
    """Half the step against the whole."""
    rows = []
    for name in preset_names():
        volts = 4.0 * force("uniform", 1)
        coarse, fine = (
            Plant(PlantParameters(), load_preset(name), substeps=k * SUBSTEPS).advance(volts) for k in (1, 2)
        )
        cells = [name]
        for column in ("position", "velocity", "current", "filtered_current"):
            error = coarse[column] - fine[column]
            rms, peak = error.std() / fine[column].std(), np.abs(error).max() / np.ptp(fine[column])
            cells.append(f"{rms:.0e} / {peak:.0e}")
        rows.append([*cells, f"{100 * (1 - fine['touching'].mean()):.1f}"])
    return table(["preset", "position", "velocity", "current", "filtered current", "lifted off %"], rows)


def speed_table() -> str:
    """How fast the plant runs."""
    plant = Plant(PlantParameters(), load_preset("left-posterior-forearm"))
    volts = 4.0 * force("gaussian", 1)
    plant.advance(volts)
    taken = []
    for _ in range(3):
        start = time.process_time()
        plant.advance(volts)
        taken.append(time.process_time() - start)
    return f"{volts.size / SAMPLE_RATE_HZ / min(taken):.0f} times real time (processor time of one core)."


def draw() -> None:
    """The picture: the static nonlinearity with its loops, and localised tests against the plant's own values."""
    name = "left-posterior-forearm"
    tissue = load_preset(name)
    record = measured(tissue, "gaussian", 1)
    model = get_engine("wiener")().fit(record)
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.4), layout="constrained")
    linear = model.linear_output(record.input)
    axes[0].plot(linear[250:], 1e3 * record.output[250:], ".", markersize=1, color="tab:blue")
    order = np.argsort(linear[250:])
    axes[0].plot(linear[250:][order], 1e3 * model.simulate(record.input)[250:][order], color="tab:red")
    axes[0].set(xlabel="linear output (N)", ylabel="position (mm)", title="standard test")
    titles = (("mass (g)", 1e3), ("damping (N s/m)", 1.0), ("stiffness (kN/m)", 1e-3))
    found = [measured(tissue, "small", 2, mean) for mean in (1.0, 2.0, 3.0, 4.0, 5.0, 6.5, 8.0)]
    depths = [1e3 * r.output.mean() for r in found]
    values = [fit("lms", r)[1] for r in found]
    line = np.linspace(min(depths), max(depths), 60)
    truth = [local_values(name, 1e-3 * p) for p in line]
    for axis, key, (label, scale) in zip(axes[1:], COMPARED, titles, strict=True):
        axis.plot(line, [scale * t[key] for t in truth], color="tab:grey", label="plant")
        axis.plot(depths, [scale * v[key] for v in values], "o", color="tab:red", label="small tests")
        axis.set(xlabel="position (mm)", title=label)
    axes[1].legend(frameon=False)
    figure.savefig(PICTURE, dpi=110)


def models_table() -> str:
    """The figures in which the two devices differ."""
    plants = [MODELS[name].plant for name in MODELS]
    rows = [
        [what, *(format(scale * getattr(plant, name), ".4g") for plant in plants)]
        for what, name, scale in (
            ("resistance, ohm", "resistance_ohm", 1.0),
            ("inductance, mH", "inductance_h", 1e3),
            ("force constant, N/A", "force_constant_n_per_a", 1.0),
            ("moving mass, g", "moving_mass_kg", 1e3),
            ("weight, N", "gravity_force_n", 1.0),
            ("heat capacity, J/K", "heat_capacity_j_per_k", 1.0),
            ("thermal resistance, K/W", "thermal_resistance_k_per_w", 1.0),
        )
    ]
    rows.append(["mass that takes the reaction, kg", *(f"{m.frame_mass_kg:.4g}" for m in MODELS.values())])
    rows.append(["greatest force that it permits, N", *(f"{m.max_force_n:.4g}" for m in MODELS.values())])
    return table(["figure", *MODELS], rows)


def coil_table() -> str:
    """The finite coil's force constant along the stroke, and its linear region."""
    plant = PlantParameters()
    values = profile_values(finite_coil(plant.stroke_m), plant.force_constant_n_per_a, plant.stroke_m)
    where, found = np.array(values["position_m"]), np.array(values["force_constant_n_per_a"])
    shown = [0, 2, 4, 6, 8, 12, 16, 20, 24, 26, 28, 30, 32]
    row = ["N/A", *(f"{np.interp(1e-3 * at, where, found):.3f}" for at in shown)]
    region = [1e3 * float(values[name]) for name in ("linear_region_min_m", "linear_region_max_m")]
    return (
        table(["position, mm", *map(str, shown)], [row])
        + f"\n\nWithin 5 % of its plateau from {region[0]:.2f} to {region[1]:.2f} mm: {region[1] - region[0]:.1f} mm."
    )


def rates_table() -> str:
    """Steps, their error and speed at several sample rates, under the uniform standard test."""
    volts = 4.0 * force("uniform", 1)
    rows = []
    for rate in (500.0, 1000.0, 2000.0, 4000.0, 10_000.0):
        bench = Bench(sample_rate_hz=rate)
        times = rate / SAMPLE_RATE_HZ
        held = np.repeat(volts, round(times)) if times >= 1 else volts[:: round(1 / times)]
        steps = bench.plant.substeps
        fine = Plant(PlantParameters(), bench.tissue, sample_rate_hz=rate, substeps=8 * steps).advance(held)
        best = np.inf
        for _ in range(3):
            bench.reset()
            begin = time.process_time()
            trace = bench.plant.advance(held)
            best = min(best, time.process_time() - begin)
        errors = [(trace[n] - fine[n]).std() / fine[n].std() for n in ("position", "velocity", "filtered_current")]
        length = [f"{rate:g}", str(steps), f"{1e6 / rate / steps:.0f}"]
        rows.append([*length, *(f"{e:.0e}" for e in errors), f"{held.size / rate / best:.0f}"])
    head = ["samples a second", "steps to a sample", "step, µs", "position", "velocity", "filtered current"]
    return table([*head, "times real time"], rows)


TABLES: dict[str, Callable[[], str]] = {
    "standard": standard_table,
    "averages": averages_table,
    "small": small_table,
    "ablation": ablation_table,
    "materials": materials_table,
    "models": models_table,
    "coil": coil_table,
    "steps": step_table,
    "rates": rates_table,
    "speed": speed_table,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables, or write them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="put tables and picture into the data")
    parser.add_argument("--only", choices=sorted(TABLES), action="append", help="make only this table")
    options = parser.parse_args(arguments)
    for name in options.only or TABLES:
        made = TABLES[name]()
        print(f"\n{name}\n\n{made}", flush=True)
        if options.write:
            replace_section("simulated-instrument", name, text=made)
    if options.write:
        draw()


if __name__ == "__main__":
    main()
