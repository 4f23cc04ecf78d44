"""Compile the numba functions once, in parallel with other checks, so that workers and firmware need not."""

from __future__ import annotations

import numpy as np
from identification import simulated

from firmware_sim.bench import Bench
from firmware_sim.effects import read_effects
from firmware_sim.second_laboratory.integrator import simulate as simulate_second
from firmware_sim.second_laboratory.parameters import PlantModel
from tissueid.identification import engine_names, get_engine
from tissueid.twin.catalogue import all_effects
from tissueid.twin.chain_parameters import InstrumentParameters, spring
from tissueid.twin.simulation import Start, compiled, simulate


def main() -> None:
    """Use once what many tests use; what a few files use alone is compiled there."""
    Bench().warm_up()
    Bench(effects=read_effects({"dry_friction": {"level": 0.5}})).warm_up()
    second = PlantModel()
    for name in ("resistance_ohm", "inductance_h", "mass_kg"):
        second.values[name] = 1.0
    simulate_second(second, 25e-6, (np.zeros(10), np.zeros(10)), np.zeros(11), np.zeros(11))
    simulate(np.zeros(10), 2000.0, InstrumentParameters(), spring(0.012, 1000.0, 0.005, 0.4), Start(0.0, 0.012))
    for effect in all_effects().values():
        if effect.hook is not None:
            compiled(effect.hook)
    noise = np.random.default_rng(0).normal(size=1000)
    all_effects()["physiological_motion"].estimate_from_records([{"position": noise, "voltage": noise}], 1000.0)
    record = simulated.wiener_record(1)
    for name in set(engine_names()) - {"cascade", "depth", "localized"}:
        get_engine(name).from_options({}).fit(record)


if __name__ == "__main__":
    main()
