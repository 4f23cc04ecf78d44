"""Tables of studies with known effects, drawn without recordings."""

from __future__ import annotations

import numpy as np
import pandas as pd

SITES = ("left anterior forearm", "left posterior forearm")


def generated_table(
    seed,
    subjects=16,
    repeats=5,
    names=("k",),
    within=0.04,
    between=0.15,
    gender=0.0,
    bmi=0.0,
    lotion=None,
    first=0.0,
    site=0.0,
):
    """Return a table as of ``study_run``; effects are relative to a mean of 100.

    ``gender`` is that of males, ``bmi`` per kg/m², ``first`` that of all tests after the first, ``site`` that of the
    second site, and ``lotion`` that of a second condition (None for no second condition).
    """
    random = np.random.default_rng([seed, 25])
    rows = []
    origins = random.permutation(np.resize(["a", "b", "c", "d"], subjects))
    for who in range(subjects):
        male, index, age = bool(who % 2), float(random.normal(23.0, 2.8)), float(random.integers(18, 37))
        height = float(random.normal(1.7, 0.07))
        about = {
            "subject": f"P-{who:03d}",
            "gender": "male" if male else "female",
            "ethnicity": origins[who],
            "age_years": age,
            "age_group": "< 25" if age < 25 else "≥ 25",
            "height_m": height,
            "weight_kg": index * height**2,
            "bmi_kg_per_m2": index,
        }
        own = {name: between * random.normal() for name in names}
        for place in range(len(SITES)):
            for condition in ("",) if lotion is None else ("", "lotion"):
                for repeat in range(1, repeats + 1):
                    row = about | {
                        "session": f"{who}-{place}-{condition}.h5",
                        "test": repeat,
                        "site": SITES[place],
                        "condition": condition,
                        "repeat": repeat,
                        "status": "completed",
                        "quality": "good",
                        "configuration": "indentation",
                        "problem": "",
                    }
                    for name in names:
                        mean = 1.0 + own[name] + gender * male + bmi * (index - 23.0) + site * place
                        mean += first * (repeat > 1) + (lotion or 0.0) * (condition == "lotion")
                        row[name] = 100.0 * (mean + within * random.normal())
                        row[f"{name}_sd"] = 100.0 * within
                    rows.append(row)
    return pd.DataFrame(rows)
