"""What ``simulated://`` can put under the probe."""

from __future__ import annotations

from tissueid.twin.figures import Tissue, spring

TISSUES = {
    # Averages of thesis 3.1.3 for the posterior forearm; the softer anterior site after Table 3.1.
    "forearm": Tissue(),
    "anterior-forearm": Tissue(stiffness_n_per_m=350.0, stiffness_growth_per_m=200.0),
    "spring": spring(0.005, 1000.0),
}
