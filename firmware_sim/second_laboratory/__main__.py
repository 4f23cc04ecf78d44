"""``python -m firmware_sim.second_laboratory``: draw scenarios with hidden effects and write signals and labels."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from firmware_sim.second_laboratory.recording import EFFECTS
from firmware_sim.second_laboratory.scenarios import Shares, draw_scenario, write_labels, write_scenario


def _share(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"must be between 0 and 1, got {text}")
    return value


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("python -m firmware_sim.second_laboratory", description=__doc__)
    parser.add_argument("--seed", type=int, default=1, help="random seed; equal seeds give equal scenarios")
    parser.add_argument("--n", type=int, default=20, help="number of scenarios")
    parser.add_argument("--out", type=Path, required=True, help="a new or empty folder")
    shares = (
        ("full", 0.5, "with the full series of tests"),
        ("none", 0.1, "without any effect"),
        ("pairs", 0.1, "with two effects of different stages"),
        ("unknown", 0.1, "with an effect that is not listed"),
    )
    for name, default, help_text in shares:
        parser.add_argument(f"--{name}-share", type=_share, default=default, help=f"share {help_text}")
    parser.add_argument("--sets", type=_share, default=0.0, help="share with two to four effects of different stages")
    parser.add_argument(
        "--without", nargs="+", default=[], metavar="NAME", choices=list(EFFECTS), help="effects that are not drawn"
    )
    parser.add_argument(
        "--clean", action="store_true", help="also record without noise, without effects, and each effect of several"
    )
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw, record and write scenarios; the labels are written last."""
    parser = _parser()
    chosen = parser.parse_args(arguments)
    out: Path = chosen.out
    try:
        out.mkdir(parents=True, exist_ok=True)
        if any(out.iterdir()):
            parser.error(f"{out} is not empty")
        shares = Shares(chosen.full_share, chosen.none_share, chosen.unknown_share, chosen.pairs_share, chosen.sets)
        labels = {}
        for number in range(1, chosen.n + 1):
            scenario = draw_scenario(chosen.seed, number, shares, chosen.without)
            write_scenario(out, scenario, clean=chosen.clean)
            labels[f"scenario-{number:04d}"] = scenario.label()
        seal = write_labels(out, labels)
    except OSError as error:
        parser.error(f"cannot write to {out}: {error.strerror}")
    print(f"{chosen.n} scenarios in {out}; SHA-256 of labels.json: {seal}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
