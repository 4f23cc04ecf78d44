"""Measures the attached, stretched and layered tissues, the probes and the lotions of the simulated instrument.

Without options it prints the tables; ``--write`` puts them into docs/measured/simulated-instrument.json and draws.
Identified figures are those of ``tissueid identify --engine localized`` on recorded sessions: one guided test of 2 s at
each load, ±0.75 N.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from measured import replace_section
from support import LoopbackLink

from firmware_sim.firmware import Firmware
from firmware_sim.local_values import local_values
from firmware_sim.lotions import LOTIONS, with_lotion
from firmware_sim.plant import SUBSTEPS, Plant, PlantParameters
from firmware_sim.presets import DEFAULT, load_preset
from firmware_sim.probe import Probe
from firmware_sim.scenario import load_scenario
from firmware_sim.tissue import Tissue
from tissueid.acquisition import GuidedTest, SessionRecorder, run_guided_test, usual_noise
from tissueid.acquisition.surface_detection import place
from tissueid.analysis import analyse
from tissueid.identification.depth_profile import DepthProfile
from tissueid.instrument import SerialInstrument
from tissueid.sessions import read_session
from tissueid.test_settings import TestSettings

matplotlib.use("Agg")
from matplotlib import pyplot as plt

HERE = Path(__file__).parent
PICTURE = HERE / "simulated-tissues.png"
SITES = {"AP": "extension-anterior", "PP": "extension-posterior"}
DIRECTIONS = {"vertical": 0.0, "horizontal": 90.0}
HORIZONTAL = PlantParameters(gravity_force_n=0.0)


@cache
def recorded(preset: str, loads: tuple[float, ...], coupling: str = "none", angle: float | None = None) -> DepthProfile:
    """Record one session with a small test at each load and identify it by levels."""
    options: dict[str, Any] = {"preset": preset, "seed": 5}
    name = "indentation"
    if angle is not None:
        name = "extension"
        options |= {"orientation_deg": angle, "tilt_deg": 90.0}
    settings = TestSettings(site=preset, configuration=name, coupling=coupling, orientation_deg=angle)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "s.h5"
        link = LoopbackLink(Firmware(load_scenario(None, **options).bench(), seed=5))
        with SerialInstrument(link, clock=link.clock) as instrument:
            recorder = SessionRecorder(path, instrument.device)
            placement = place(instrument)
            for load in loads:
                noise = usual_noise(2000.0, force_min_n=load - 0.75, force_max_n=load + 0.75, seconds=2.0)
                test = GuidedTest(noise, settings)
                run_guided_test(instrument, test, recorder, surface_m=placement)
                cooled = link.now + 10.0
                while link.now < cooled:
                    instrument.poll(0.2)
            recorder.write()
        session = read_session(path)
    numbers = [test.number for test in session.tests]
    profile = analyse(session, "localized", test=numbers[0], also=tuple(numbers[1:])).depth_profile()
    assert profile is not None
    return profile


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def found_against(true: float, found: float) -> str:
    """An identified value with its error."""
    return f"{found:.0f} ({100.0 * (found / true - 1.0):+.1f} %)"


def attached() -> DepthProfile:
    """The attached forearm, pulled and pushed."""
    loads = (-5.0, -4.0, -3.0, -2.0, -1.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0)
    return recorded("forearm-attached", loads, "adhesive")


def attached_table() -> str:
    """Pulling against pushing at equal distance."""
    tissue = load_preset("forearm-attached")
    rows = []
    for distance in (0.5, 1.0, 1.5, 2.0, 2.5):
        both = [local_values(tissue, tissue.surface_m + way * 1e-3 * distance) for way in (1.0, -1.0)]
        forces = [tissue.elastic_force(way * 1e-3 * distance) for way in (1.0, -1.0)]
        stiffness = [values["stiffness_n_per_m"] for values in both]
        damping = [values["damping_n_s_per_m"] for values in both]
        rows.append(
            [
                f"{distance:g}",
                f"{forces[0]:.2f} / {forces[1]:.2f}",
                f"{stiffness[0]:.0f} / {stiffness[1]:.0f}",
                f"{stiffness[1] / stiffness[0]:.2f}",
                f"{damping[0]:.1f} / {damping[1]:.1f}",
            ]
        )
    head = ["distance mm", "force N, pushed / pulled", "stiffness N/m, pushed / pulled", "ratio"]
    return table([*head, "damping N s/m, pushed / pulled"], rows)


def attached_found_table() -> str:
    """What the levels of a session find."""
    tissue, profile = load_preset("forearm-attached"), attached()
    rows = []
    for k, position in enumerate(profile.position):
        true = local_values(tissue, float(position))
        rows.append(
            [
                f"{1e3 * (position - tissue.surface_m):+.2f}",
                found_against(1e3 * true["mass_kg"], 1e3 * profile.mass[k]),
                f"{profile.damping[k]:.1f} ({100 * (profile.damping[k] / true['damping_n_s_per_m'] - 1):+.1f} %)",
                f"{found_against(true['stiffness_n_per_m'], profile.stiffness[k])} ± {profile.stiffness_std[k]:.0f}",
            ]
        )
    return table(["depth mm", "mass g", "damping N s/m", "stiffness N/m"], rows)


def strip(site: str, angle: float) -> DepthProfile:
    """A strip of skin in one direction."""
    return recorded(SITES[site], (0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0), "adhesive", angle)


def extension_table() -> str:
    """The two directions of both sites, the materials, and indentation, at equal force."""
    forces = (0.5, 1.0, 2.0, 4.0, 6.0, 8.0)
    rows = []
    for site, preset in SITES.items():
        values = []
        for name, angle in DIRECTIONS.items():
            tissue, profile = load_preset(preset).stretched(angle), strip(site, angle)
            values.append([_tangent(tissue, force) for force in forces])
            rows.append([f"{site} {name}", *(f"{value:.0f}" for value in values[-1])])
            identified = [
                f"{profile.stiffness[np.argmin(np.abs(profile.position - _at(tissue, force)))]:.0f}" for force in forces
            ]
            rows.append([f"{site} {name}, identified", *identified])
        rows.append([f"{site} vertical / horizontal", *(f"{a / b:.2f}" for a, b in zip(*values, strict=True))])
    others = ("extension-lycra", "extension-latex", "left-anterior-forearm", "left-posterior-forearm")
    rows += [[name, *(f"{_tangent(load_preset(name), force):.0f}" for force in forces)] for name in others]
    return table(["stiffness in N/m at", *(f"{force:g} N" for force in forces)], rows)


def _at(tissue: Tissue, force_n: float) -> float:
    return Plant(HORIZONTAL, tissue).static_position(force_n)


def _tangent(tissue: Tissue, force_n: float) -> float:
    return float(local_values(tissue, _at(tissue, force_n))["stiffness_n_per_m"])


def _compressions(tissue: Tissue, force_n: float) -> list[float]:
    return [
        layer.thickness_m * force_n / (layer.stiffness_n_per_m * layer.thickness_m + force_n)
        if layer.thickness_m
        else force_n / layer.stiffness_n_per_m
        for layer in tissue.layers
    ]


def layers_table() -> str:
    """How the layers bottom out one after the other."""
    tissue = load_preset("forearm-layered")
    rows = []
    for force in (0.1, 0.3, 1.0, 2.0, 4.0, 8.0, 11.0):
        parts = _compressions(tissue, force)
        depth = sum(parts)
        shares = [
            f"{100.0 * part / (layer.thickness_m or np.inf):.0f}"
            for part, layer in zip(parts[:-1], tissue.layers, strict=False)
        ]
        true = local_values(tissue, tissue.surface_m + depth)
        rows.append(
            [
                f"{force:g}",
                f"{1e3 * depth:.2f}",
                " / ".join(shares),
                f"{1e3 * tissue.layer_values(depth)[2]:.1f}",
                f"{tissue.layer_values(depth)[1]:.1f}",
                f"{true['relaxation']['relaxed_stiffness_n_per_m']:.0f}",
            ]
        )
    head = ["force N", "depth mm", "compressed %: dermis / fat / muscle", "mass of the layers g", "their damping N s/m"]
    return table([*head, "stiffness N/m"], rows)


def layered() -> DepthProfile:
    """The layered forearm by levels."""
    return recorded("forearm-layered", (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0))


def layers_found_table() -> str:
    """What the levels of a session find."""
    tissue, profile = load_preset("forearm-layered"), layered()
    rows = []
    for k, position in enumerate(profile.position):
        true = local_values(tissue, float(position))
        rows.append(
            [
                f"{1e3 * (position - tissue.surface_m):.2f}",
                found_against(1e3 * true["mass_kg"], 1e3 * profile.mass[k]),
                f"{profile.damping[k]:.1f} ({100 * (profile.damping[k] / true['damping_n_s_per_m'] - 1):+.1f} %)",
                f"{found_against(true['stiffness_n_per_m'], profile.stiffness[k])} ± {profile.stiffness_std[k]:.0f}",
            ]
        )
    return table(["depth mm", "mass g", "damping N s/m", "stiffness N/m"], rows)


PROBES = ("3", "4.4", "indenter-4.3mm", "indenter-5mm", "6", "8", "8:2")


def _probe(text: str) -> Probe:
    from firmware_sim.probe import read_probe

    return read_probe(text)


def probes_table() -> str:
    """Factors of stiffness and damping by depth, of mass, and the local values of the default preset."""
    rows = []
    for text in PROBES:
        probe = _probe(text)
        tissue = load_preset(DEFAULT).with_probe(probe)
        deep = local_values(tissue, tissue.surface_m + 2.5e-3)
        rows.append(
            [
                f"{1e3 * probe.diameter_m:g}, {1e3 * probe.corner_radius_m:g}",
                *(f"{probe.factor(depth):.2f}" for depth in (1e-4, 1e-3, 3e-3)),
                f"{probe.radius_ratio**3:.2f}",
                f"{deep['stiffness_n_per_m']:.0f}",
                f"{deep['damping_n_s_per_m']:.1f}",
                f"{1e3 * deep['mass_kg']:.0f}",
                f"{_tangent(tissue, 4.0):.0f}",
            ]
        )
    head = ["diameter, corner radius mm", "factor at 0.1 mm", "at 1 mm", "at 3 mm", "factor of mass"]
    return table([*head, "K at 2.5 mm, N/m", "B, N s/m", "M, g", "K at 4 N, N/m"], rows)


def lotions_table() -> str:
    """What a lotion changes."""
    skin, sliding = load_preset(DEFAULT), load_preset("sliding-preloaded-skin")
    rows = []
    for name in ("none", *LOTIONS):
        both = [tissue if name == "none" else with_lotion(tissue, name) for tissue in (skin, sliding)]
        at = [local_values(both[0], skin.surface_m + depth) for depth in (1e-3, 2e-3, 3e-3)]
        along = local_values(both[1], sliding.surface_m)
        rows.append(
            [
                name,
                " / ".join(f"{values['stiffness_n_per_m']:.0f}" for values in at),
                f"{at[1]['parts']['tissue_damping_n_s_per_m']:.2f}",
                f"{1e3 * at[1]['mass_kg']:.1f}",
                f"{along['stiffness_n_per_m'] - sliding.external_spring_n_per_m:.0f}",
                f"{along['parts']['tissue_damping_n_s_per_m']:.1f}",
            ]
        )
    head = ["lotion", "indentation: K at 1 / 2 / 3 mm, N/m", "B of the tissue at 2 mm", "M at 2 mm, g"]
    return table([*head, "surface: K less the spring, N/m", "B of the tissue, N s/m"], rows)


def steps_table() -> str:
    """Half the step against the whole."""
    cases = {
        "forearm-attached, −5 to 8 N": (load_preset("forearm-attached"), -5.0, 8.0),
        "forearm-layered": (load_preset("forearm-layered"), -3.5, 10.5),
        "extension-anterior, vertical": (load_preset("extension-anterior"), -3.5, 10.5),
        "extension-anterior, horizontal": (load_preset("extension-anterior").stretched(90.0), -3.5, 10.5),
        "extension-posterior, horizontal": (load_preset("extension-posterior").stretched(90.0), -3.5, 10.5),
        "extension-lycra": (load_preset("extension-lycra"), -3.5, 10.5),
        "extension-latex": (load_preset("extension-latex"), -3.5, 10.5),
        "sliding-preloaded-skin": (load_preset("sliding-preloaded-skin"), -3.5, 10.5),
        f"{DEFAULT}, 5 mm / 1.3 mm": (load_preset(DEFAULT).with_probe(_probe("indenter-5mm")), -3.5, 10.5),
    }
    rows = []
    for name, (tissue, low, high) in cases.items():
        noise = usual_noise(2000.0, force_min_n=low, force_max_n=high, distribution="uniform")
        volts = 4.0 * noise.values
        coarse, fine = (Plant(PlantParameters(), tissue, substeps=k * SUBSTEPS).advance(volts) for k in (1, 2))
        cells = []
        for signal in ("position", "velocity", "current"):
            error = coarse[signal] - fine[signal]
            cells.append(f"{error.std() / fine[signal].std():.0e} / {np.abs(error).max() / np.ptp(fine[signal]):.0e}")
        rows.append([name, *cells, f"{100.0 * (1.0 - fine['touching'].mean()):.1f}"])
    return table(["tissue", "position", "velocity", "current", "lifted off %"], rows)


def draw() -> None:
    """The picture: levels against the true values."""
    figure, axes = plt.subplots(2, 2, figsize=(10.5, 7.6), layout="constrained")
    pulled, directions, layers, probes = axes.flat
    tissue, profile = load_preset("forearm-attached"), attached()
    depth = np.linspace(-2.8e-3, 4.6e-3, 150)
    true = [local_values(tissue, tissue.surface_m + y)["stiffness_n_per_m"] for y in depth]
    pulled.plot(1e3 * np.abs(depth[depth < 0]), np.array(true)[depth < 0] / 1e3, "C3", label="pulled")
    pulled.plot(1e3 * depth[depth > 0], np.array(true)[depth > 0] / 1e3, "C0", label="pushed")
    away = 1e3 * (profile.position - tissue.surface_m)
    colours = np.where(away < 0, "C3", "C0")
    pulled.scatter(np.abs(away), profile.stiffness / 1e3, c=colours, zorder=3, label="identified by levels")
    pulled.set(title="Attached forearm", xlabel="Distance from the surface (mm)", ylabel="Stiffness (kN/m)")
    pulled.legend()
    for colour, (site, preset) in zip(("C0", "C1"), SITES.items(), strict=True):
        for style, (name, angle) in zip(("-", "--"), DIRECTIONS.items(), strict=True):
            stretched, levels = load_preset(preset).stretched(angle), strip(site, angle)
            forces = np.linspace(0.2, 8.5, 60)
            stiffness = np.array([_tangent(stretched, force) for force in forces])
            directions.plot(forces, stiffness / 1e3, colour + style, label=f"{site} {name}")
            at = [stretched.elastic_force(position - stretched.surface_m) for position in levels.position]
            directions.scatter(at, levels.stiffness / 1e3, c=colour, s=14, zorder=3)
    directions.set(title="Extension in two directions", xlabel="Force (N)", ylabel="Stiffness (kN/m)")
    directions.legend()
    tissue, profile = load_preset("forearm-layered"), layered()
    forces = np.geomspace(0.02, 12.0, 150)
    parts = np.array([_compressions(tissue, force) for force in forces])
    layers.stackplot(
        forces, 1e3 * parts.T, labels=("dermis", "fat", "muscle", "base"), colors=("C1", "C8", "C5", "C7"), alpha=0.7
    )
    layers.set(title="Layers in series", xlabel="Force (N)", ylabel="Compression (mm)")
    second = layers.twinx()
    depths = parts.sum(axis=1)
    stiffness = [local_values(tissue, tissue.surface_m + y)["stiffness_n_per_m"] for y in depths]
    carried = [tissue.elastic_force(y) for y in depths]
    second.plot(carried, np.array(stiffness) / 1e3, "k", label="stiffness")
    at = [tissue.elastic_force(position - tissue.surface_m) for position in profile.position]
    second.plot(at, profile.stiffness / 1e3, "ko", label="identified by levels")
    second.set_ylabel("Stiffness (kN/m)")
    second.legend(loc="lower right")
    layers.legend(loc="upper left")
    depth = np.linspace(1e-5, 3e-3, 100)
    for text in ("3", "4.4", "indenter-5mm", "8", "8:2"):
        probe = _probe(text)
        label = f"{1e3 * probe.diameter_m:g} mm, corner {1e3 * probe.corner_radius_m:g} mm"
        probes.plot(1e3 * depth, [probe.factor(y) for y in depth], label=label)
    probes.set(title="Probes", xlabel="Depth (mm)", ylabel="Factor of stiffness and damping")
    probes.legend()
    figure.savefig(PICTURE, dpi=110)


TABLES = {
    "attached": attached_table,
    "attached-found": attached_found_table,
    "extension": extension_table,
    "layers": layers_table,
    "layers-found": layers_found_table,
    "probes": probes_table,
    "lotions": lotions_table,
    "tissue-steps": steps_table,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables, or write them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="put tables and picture into the data")
    options = parser.parse_args(arguments)
    for name, make in TABLES.items():
        made = make()
        print(f"\n{name}\n\n{made}", flush=True)
        if options.write:
            replace_section("simulated-instrument", name, text=made)
    if options.write:
        draw()


if __name__ == "__main__":
    main()
