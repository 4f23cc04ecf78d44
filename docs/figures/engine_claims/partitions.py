"""Depth and direction partitions, and localized linear tests."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from identification import simulated_dpn, simulated_stepped
from outside_data import RIG
from scipy import linalg

from engine_claims.base import Claim
from tissueid.identification import get_engine, validated
from tissueid.identification.depth_profile import DepthProfile
from tissueid.records import Record
from tissueid.sessions import read_session

SEEDS = 3
FIT_SHARE = 0.75


def claims() -> Iterable[Claim]:
    """Every claim, measured."""
    yield from _figure_5_2()
    yield _stochastic()
    yield from _tissues()
    yield from _direction()
    yield _localized()
    yield _exact()
    if RIG.exists():
        yield from _rig()


def _off(profile: DepthProfile, truth: np.ndarray) -> np.ndarray:
    """Mean relative error, percent, of M, B and K over the rows, (3,), from the truth (3, rows)."""
    found = np.array([profile.mass, profile.damping, profile.stiffness])
    return 100.0 * np.mean(np.abs(found / truth - 1.0), axis=1)


def _figure_5_2() -> Iterable[Claim]:
    for offset, asked in (("partition", True), ("common", False)):
        errors: dict[int, list[np.ndarray]] = {}
        for continuous, repetitions in ((100, 1), (20, 5), (50, 4), (20, 10), (200, 4), (20, 40))[:: 1 if asked else 2]:
            for seed in range(SEEDS):
                record = simulated_stepped.stepped_wiener(5, seed, continuous=continuous, repetitions=repetitions)
                engine = get_engine("depth").from_options(
                    {"memory": 0.12, "partitions": 5, "downsample": 1, "offset": offset, "hold": "zero-order"}
                )
                profile = engine.fit(record).depth_profile()
                truth = simulated_stepped.wiener_local(profile.position).T
                errors.setdefault(continuous * repetitions * 5, []).append(_off(profile, truth))
        means = {points: np.mean(found, axis=0) for points, found in errors.items()}
        told = "; ".join(f"{n}: {m:.1f}, {b:.1f}, {k:.1f}" for n, (m, b, k) in means.items())
        kept = not asked or all(np.all(mean < 5.0) for mean in means.values())
        yield Claim(
            f'depth, stepped Wiener system of Fig. 5.2, `offset="{offset}"`: error of M, B, K by points, %',
            "under 5 from 500 points on" if asked else "no target",
            told,
            kept,
        )


def _stochastic() -> Claim:
    found = {}
    for offset in ("common", "partition"):
        errors = []
        for seed in range(SEEDS):
            record = simulated_stepped.stochastic_wiener(6, seed)
            options = {"memory": 0.12, "downsample": 1, "offset": offset, "hold": "zero-order"}
            profile = get_engine("depth").from_options(options).fit(record).depth_profile()
            errors.append(_off(profile, simulated_stepped.wiener_local(profile.position).T))
        found[offset] = np.mean(errors, axis=0)
    told = "; ".join(f"{name}: {m:.1f}, {b:.1f}, {k:.1f}" for name, (m, b, k) in found.items())
    kept = bool(np.all(found["common"] < 5.0) and np.all(found["partition"] < 5.0))
    return Claim("depth, Wiener system under a stochastic input (Fig. 5.1): error of M, B, K, %", "under 5", told, kept)


def _tissues() -> Iterable[Claim]:
    for name, tissue in (
        ("underdamped, damping ratio 0.3", simulated_dpn.SKIN),
        ("mass grows too", simulated_dpn.GROWING),
        ("constants of C.1.4", simulated_dpn.THESIS),
    ):
        errors, held, plain = [], [], []
        for seed in range(SEEDS):
            record = simulated_dpn.record(tissue, 400 + seed)
            profile = get_engine("depth")().fit(record).depth_profile()
            truth = _truth(tissue, profile)
            errors.append(_off(profile, truth))
            values = np.array([profile.mass, profile.damping, profile.stiffness])
            std = np.array([profile.mass_std, profile.damping_std, profile.stiffness_std])
            held.append(np.abs(values - truth) < 1.96 * std)
            raw = get_engine("depth").from_options({"correct": False}).fit(record).depth_profile()
            plain.append(_off(raw, _truth(tissue, raw)))
        mean, before, hold = np.mean(errors, axis=0), np.mean(plain, axis=0), 100.0 * np.mean(held)
        yield Claim(
            f"depth, stochastic test on a tissue whose B and K grow with depth ({name}): error of M, B, K, %",
            "under 5",
            f"{mean[0]:.1f}, {mean[1]:.1f}, {mean[2]:.1f} (uncorrected {before[0]:.1f}, {before[1]:.1f}, "
            f"{before[2]:.1f}); 95 % intervals hold {hold:.0f} %",
            bool(np.all(mean < 5.0)),
        )


def _truth(tissue: simulated_dpn.Tissue, profile: DepthProfile) -> np.ndarray:
    y = profile.position
    damping = tissue.dampings(y) * (1.0 + tissue.turn * profile.direction)
    return np.array([tissue.masses(y), damping, tissue.tangents(y)])


def _direction() -> Iterable[Claim]:
    for turn in (0.25, 0.0):
        shares = []
        for seed in range(SEEDS):
            for tissue in (simulated_dpn.SKIN, simulated_dpn.GROWING):
                record = simulated_dpn.record(replace(tissue, turn=turn), 500 + seed)
                found = get_engine("direction")().fit(record).report.parameters
                inwards, outwards = (found[f"damping_{way}_n_s_per_m"].value for way in ("in", "out"))
                shares.append((inwards - outwards) / (inwards + outwards))
        share = 100.0 * np.array(shares)
        yield Claim(
            f"direction: damping {100 * turn:g} % above its mean in indentation, as much below in retraction"
            if turn
            else "direction: equal damping in both directions",
            "within 3 points",
            f"{share.mean():.1f} % ({share.min():.1f} to {share.max():.1f})",
            bool(np.all(np.abs(share - 100.0 * turn) < 3.0)),
        )


def _localized() -> Claim:
    force = simulated_stepped.staircase(1)
    steps = 4
    fine = np.interp(np.arange(2 * steps * force.size + 1) / (2 * steps), np.arange(force.size), force)
    tissue = simulated_dpn.GROWING
    position = simulated_dpn.integrate(tissue, fine, 1.0 / (2000.0 * steps), steps)
    position = position + 5e-8 * np.random.Generator(np.random.PCG64(8)).standard_normal(force.size)
    profile = get_engine("localized").from_options({"memory": 0.1}).fit(Record(force, position, 2000.0)).depth_profile()
    y = profile.position
    mass, damping, stiffness = _off(profile, np.array([tissue.masses(y), tissue.dampings(y), tissue.tangents(y)]))
    return Claim(
        f"localized, staircase of {len(profile)} levels: error of M, B, K, %",
        "under 2",
        f"{mass:.1f}, {damping:.1f}, {stiffness:.1f}",
        max(mass, damping, stiffness) < 2.0,
    )


def _exact() -> Claim:
    record = simulated_stepped.stochastic_wiener(9, n=4000)
    model = (
        get_engine("depth")
        .from_options({"memory": 0.08, "partitions": 15, "downsample": 1, "correct": False, "hold": "zero-order"})
        .fit(record)
    )
    lags, edges = 40, model.breakpoints_m
    columns = [np.ones(len(record) - lags + 1)]
    for low, high in zip([-np.inf, *edges[1:-1]], [*edges[1:-1], np.inf], strict=True):
        inside = np.where((record.output >= low) & (record.output < high), record.input, 0.0)
        columns += [inside[lags - 1 - lag : len(record) - lag] for lag in range(lags)]
    theta = linalg.lstsq(np.array(columns).T, record.output[lags - 1 :])[0]
    found = np.concatenate([[model.offsets[0]], np.ravel(model.kernels) / record.sample_rate_hz])
    apart = float(np.linalg.norm(found - theta) / np.linalg.norm(theta))
    return Claim(
        "depth, 15 partitions x 40 lags: kernels against lstsq on the explicit matrix",
        "1e-8",
        f"{apart:.0e}",
        apart < 1e-8,
    )


def _rig() -> Iterable[Claim]:
    paths = sorted(RIG.glob("rig-*.h5"))
    for engine, options in (
        ("depth", {}),
        ("depth", {"offset": "partition"}),
        ("direction", {}),
    ):
        scheduled, free, place = [], [], []
        for path in paths:
            record = read_session(path).test(None).record("force", "position")
            cut = round(FIT_SHARE * len(record))
            model = get_engine(engine).from_options(options | {"correct": False}).fit(record, slice(0, cut))
            report = validated(model, record, slice(cut, None)).report
            scheduled.append(report.vaf_scheduled_percent)
            free.append(report.vaf_validation_percent)
            place.append(report.details["vaf_of_place_percent"])
        named = engine + (f', `offset="{options["offset"]}"`' if options else "")
        yield Claim(
            f"{named}, stochastic tests of the independent rig: held-out VAF, median of {len(paths)} sessions",
            "90 to 97 % scheduled",
            f"{np.median(scheduled):.1f} % scheduled, {np.median(free):.1f} % free-run (the partition of a sample "
            f"alone, without a force: {np.median(place):.1f} %)",
            bool(np.median(scheduled) >= 90.0),
        )
