"""Block structures: accuracy and identification of the structure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np
from identification import simulated_blocks
from outside_data import RIG

from engine_claims.base import Claim
from tissueid.identification import validated
from tissueid.identification.engines.cascade import Cascade
from tissueid.identification.engines.hammerstein import Hammerstein
from tissueid.identification.engines.lms import Lms
from tissueid.identification.engines.volterra import Volterra
from tissueid.identification.volterra.structure import kernel_structure
from tissueid.records import Record
from tissueid.sessions import read_session

SEEDS = 20
MEMORY = 0.06
SAMPLES = 2400

FIT_SHARE = 0.75
_RIVALS = (Lms(), Hammerstein())


def _apart(ours: np.ndarray, truth: np.ndarray) -> float:
    return 100.0 * float(np.linalg.norm(ours - truth) / np.linalg.norm(truth))


def _recovered(system: str) -> Claim:
    """Curve, kernel and free run of a Hammerstein system, fitted to the first three quarters."""
    simulated = simulated_blocks.simulate(system, 900)
    cut = round(FIT_SHARE * len(simulated.record))
    model = validated(Hammerstein().fit(simulated.record, slice(0, cut)), simulated.record, slice(cut, None))
    kernel = _apart(model.kernel, simulated_blocks.kernel(model.lag_s.size))
    force = np.quantile(simulated.record.input, np.linspace(0.01, 0.99, 99))
    truth = 1e-3 * force**2 if "square" in system else simulated_blocks.exponential(force)
    rest = np.array([model.input_mean])
    at_rest = 1e-3 * rest**2 if "square" in system else simulated_blocks.exponential(rest)
    curve = 100.0 * float(np.max(np.abs(model.nonlinearity(force) - truth + at_rest)) / np.ptp(truth))
    held_out = model.report.vaf_validation_percent or 0.0
    clean = simulated.clean[cut:]
    limit = 100.0 * (1.0 - np.var(simulated.record.output[cut:] - clean) / np.var(simulated.record.output[cut:]))
    return Claim(
        what=f"`hammerstein`, {system.split()[1]}: error of f (largest, of its range) and h; held-out VAF",
        asked="a few %; noise limit",
        measured=f"{curve:.2f} %, {kernel:.1f} %; {held_out:.2f} % (noise: {limit:.2f} %)",
        kept=curve < 3.0 and kernel < 3.0 and held_out > limit - 0.05,
    )


def _cascade_recovered(system: str) -> Claim:
    simulated = simulated_blocks.simulate(system, 901)
    cut = round(FIT_SHARE * len(simulated.record))
    name = simulated_blocks.true_name(system)
    engine = Cascade.from_options({"structure": name})
    model = validated(engine.fit(simulated.record, slice(0, cut)), simulated.record, slice(cut, None))
    dynamics = model.first_kernel if model.second_kernel is None else model.second_kernel
    kernel = _apart(dynamics / dynamics.sum(), simulated_blocks.kernel(dynamics.size))
    held_out = model.report.vaf_validation_percent or 0.0
    output = simulated.record.output[cut:]
    limit = 100.0 * (1.0 - np.var(output - simulated.clean[cut:]) / np.var(output))
    return Claim(
        what=f"`cascade`, {system}: error of the second-order block; held-out VAF",
        asked="a few %; noise limit",
        measured=f"{kernel:.1f} %; {held_out:.2f} % (noise: {limit:.2f} %)",
        kept=kernel < 5.0 and held_out > limit - 0.05,
    )


def _named(system: str) -> Claim:
    said: Counter[str] = Counter()
    for seed in range(SEEDS):
        record = simulated_blocks.simulate(system, 902, seed, n=SAMPLES).record
        model = Cascade(memory=MEMORY).fit(record)
        confident = model.choice is not None and model.choice.confident
        said[model.structure if confident else "no name"] += 1
    right = "no name" if system == "dpn" else simulated_blocks.true_name(system)
    return Claim(
        what=f"`cascade`, {system}: {SEEDS} records of {SAMPLES / simulated_blocks.RATE:g} s at 30 dB: structure named",
        asked=right,
        measured=", ".join(f"{name} {count}" for name, count in said.most_common()),
        kept=said[right] >= 0.9 * SEEDS,
    )


def _kernels_named() -> Claim:
    said = {}
    for system in (*simulated_blocks.BLOCKS, "dpn"):
        model = Volterra.from_options({"memory": 0.05}).fit(simulated_blocks.simulate(system, 903).record)
        said[system] = kernel_structure(model.kernel1, model.kernel2, model.kernel1_std, model.kernel2_std).name
    odd = {"nln": ("wiener", "lnl", "neither", "undetermined"), "dpn": ("neither",)}
    kept = all(name in odd.get(system, (simulated_blocks.true_name(system),)) for system, name in said.items())
    return Claim(
        what="`kernel_structure` on the kernels of `volterra`; kernels up to the second order cannot show NLN",
        asked="the true structure; dpn neither",
        measured="; ".join(f"{system}: {name}" for system, name in said.items()),
        kept=kept,
    )


def _rig_records(step: int) -> Iterator[Record]:
    for path in sorted(RIG.glob("rig-*.h5"))[::step]:
        yield read_session(path).test(None).record("force", "position")


def _on_the_rig() -> Iterator[Claim]:
    found = []
    for record in _rig_records(5):
        cut = round(FIT_SHARE * len(record))
        cascade = validated(Cascade().fit(record, slice(0, cut)), record, slice(cut, None))
        others = [validated(engine.fit(record, slice(0, cut)), record, slice(cut, None)) for engine in _RIVALS]
        scores = [model.report.vaf_validation_percent or 0.0 for model in (*others, cascade)]
        found.append((scores, cascade.choice is not None and cascade.choice.confident))
    if not found:
        return
    line, hammerstein, cascade_vaf = np.median([vaf for vaf, _ in found], axis=0)
    yield Claim(
        what=f"rig, median of {len(found)} sessions, held-out VAF: `lms`, `hammerstein`, `cascade`",
        asked="reported",
        measured=f"{line:.1f}, {hammerstein:.1f}, {cascade_vaf:.1f} %",
        kept=bool(np.isfinite(cascade_vaf)),
    )
    yield Claim(
        what="rig: sessions for which a block structure is named",
        asked="reported",
        measured=f"{sum(confident for _, confident in found)} of {len(found)}",
        kept=True,
    )


def claims() -> Iterator[Claim]:
    """Recovery, names over seeds, what kernels say, and the rig."""
    for system in ("hammerstein exponential", "hammerstein square"):
        yield _recovered(system)
    for system in ("wiener exponential", "wiener square", "lnl", "nln"):
        yield _cascade_recovered(system)
    for system in (*simulated_blocks.BLOCKS, "dpn"):
        yield _named(system)
    yield _kernels_named()
    yield from _on_the_rig()
