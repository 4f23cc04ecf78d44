"""Tables 7.1 to 7.5 of the thesis (Chen 2010), next to those of a study at the same sites with the same parameters.

The cells of Table 7.3 are not legible in the copy that was used; what the text says of them is there instead.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from tissueid.studies.group_comparison import one_way
from tissueid.studies.usable_tests import THESIS_SIX

SITES = {
    "left posterior forearm": "LP",
    "left anterior forearm": "LA",
    "right posterior forearm": "RP",
    "right anterior forearm": "RA",
}
INDIVIDUAL = {
    "LP": (0.040, 0.012, 0.024, 0.039, 0.031, 0.083),
    "LA": (0.052, 0.014, 0.028, 0.052, 0.034, 0.092),
    "RP": (0.039, 0.014, 0.028, 0.038, 0.030, 0.092),
    "RA": (0.043, 0.010, 0.020, 0.048, 0.027, 0.105),
}
"""Table 7.1, in the order of ``THESIS_SIX``."""
POPULATION = {
    "LP": (0.132, 0.075, 0.156, 0.123, 0.114, 0.154),
    "LA": (0.230, 0.095, 0.170, 0.221, 0.153, 0.242),
    "RP": (0.117, 0.079, 0.169, 0.124, 0.159, 0.197),
    "RA": (0.301, 0.061, 0.117, 0.290, 0.135, 0.313),
}
"""Table 7.2, in the order of ``THESIS_SIX``."""
PRINTED_MEANS = (
    (0.044, 0.013, 0.025, 0.044, 0.031, 0.093),
    (0.195, 0.077, 0.153, 0.189, 0.140, 0.226),
)
"""Last rows of Tables 7.1 and 7.2: means of the four sites."""
PARTICIPANTS = {("gender", "LA"): (8.0, 16.0), ("gender", "RA"): (17.0, 40.0), ("age_group", "RA"): (17.0, 40.0)}
"""Table 7.3c, participants per level: those that the text prints."""
_RANGES = {key: f"{least:g} – {most:g}" for key, (least, most) in PARTICIPANTS.items()}
SIGNIFICANT = {
    ("gender", "LA"): "< 0.01",
    ("gender", "RA"): "< 0.01",
    ("ethnicity", "LA"): "< 0.10",
    ("ethnicity", "RA"): "> 0.10",
    ("age_group", "LA"): "> 0.10",
    ("age_group", "RA"): "< 0.10",
}
"""Table 7.3a, p-values as the text tells them."""
SIGNIFICANT_VALUES = {
    "age_years": "> 0.10",
    "height_m": "< 0.10",
    "weight_kg": "< 0.10",
    "weight_per_height_kg_per_m": "< 0.10",
    "bmi_kg_per_m2": "< 0.10",
}
"""Table 7.3b, p-values of scaled mass and natural frequency at the anterior sites, as the text tells them."""
PARTIAL_LEAST_SQUARES = {
    "age_years": {"LP": 0.612, "LA": 0.919, "RP": 0.168, "RA": 0.998},
    "height_m": {"LP": 0.366, "LA": 0.198, "RP": 0.633, "RA": 0.188},
    "weight_kg": {"LP": 0.086, "LA": 0.032, "RP": 0.789, "RA": 0.26},
    "bmi_kg_per_m2": {"LP": 0.197, "LA": 0.09, "RP": 0.602, "RA": 0.296},
    "gender": {"LP": 0.424, "LA": 0.09, "RP": 0.94, "RA": 0.023},
}
"""Table 7.4."""
SUBGROUP = {
    "scaled_mass_s2": ((53.2e-6, 4.8e-6), (25.6e-6, 4.2e-6), "< 0.0005"),
    "scaled_damping_s": ((7.35e-3, 1.49e-3), (5.02e-3, 0.57e-3), "0.002"),
    "c1_m": ((11.99e-3, 0.79e-3), (8.66e-3, 1.03e-3), "< 0.0005"),
    "c2_per_n": ((0.287, 0.069), (0.170, 0.023), "0.001"),
}
"""Table 7.5: mean and standard deviation at the anterior and at the posterior site, and p, SI.

The thesis prints mass and damping of a linear stage of 1000 N/m (and depths in mm); divided by it they are ``mass /
stiffness`` and ``damping / stiffness``, as the engine reports them. The heads of the printed columns contradict the
text (anterior larger in all four) and are taken as interchanged.
"""
MEAN_SITE = "mean"
"""Site of a row with the mean of the sites."""
SUBGROUP_SUBJECTS = 7
"""Subjects at each site that reproduce all four p-values of Table 7.5; the thesis does not print their number."""
_YOUNGEST, _OLDEST = 18.0, 28.0


def thesis_tables(
    means: pd.DataFrame, tables: Mapping[str, pd.DataFrame], parameters: Sequence[str]
) -> dict[str, pd.DataFrame]:
    """Return the tables that can be compared, by number; none where the sites or parameters are others.

    Args:
        means: one row per subject and site.
        tables: statistics by key, as in ``StudyStatistics``.
        parameters: that were compared.
    """
    if tuple(parameters) != THESIS_SIX or means.empty or not set(SITES) & set(means["site"]):
        return {}
    results = {
        "7.1": _coefficients(tables.get("variation"), "individual_cv", INDIVIDUAL, PRINTED_MEANS[0]),
        "7.2": _coefficients(tables.get("variation"), "population_cv", POPULATION, PRINTED_MEANS[1]),
        "7.3a": _least(tables.get("groups"), ("p_value", "p_corrected"), "thesis_p", SIGNIFICANT),
        "7.3b": _regressions(tables.get("regressions")),
        "7.3c": _least(
            tables.get("sample_sizes"), ("participants_80", "participants_90"), "thesis_participants", _RANGES
        ),
        "7.4": _least_squares(tables.get("partial_least_squares")),
        "7.5": _subgroup(means),
    }
    return {key: rows for key, rows in results.items() if not rows.empty}


def _coefficients(
    rows: pd.DataFrame | None, column: str, thesis: Mapping[str, Sequence[float]], mean: Sequence[float]
) -> pd.DataFrame:
    if rows is None:
        return pd.DataFrame()
    own = rows[rows["site"].isin(SITES)]
    coefficients = []
    for index, name in enumerate(THESIS_SIX):
        values = own[own["parameter"] == name].set_index("site")
        for site, short in SITES.items():
            if site in values.index:
                row = values.loc[site]
                coefficients.append(
                    _row(short, name, row[column], row[f"{column}_low"], row[f"{column}_high"])
                    | {"thesis": thesis[short][index], "ratio": row[column] / thesis[short][index]}
                )
        if len(values):
            middle = float(values[column].mean())
            coefficients.append(
                _row(MEAN_SITE, name, middle, None, None) | {"thesis": mean[index], "ratio": middle / mean[index]}
            )
    return pd.DataFrame(coefficients)


def _row(site: str, name: str, value: float, low: float | None, high: float | None) -> dict[str, object]:
    return {"site": site, "parameter": name, "study": value, "study_low": low, "study_high": high}


def _least(
    rows: pd.DataFrame | None, columns: Sequence[str], name: str, thesis: Mapping[tuple[str, str], str]
) -> pd.DataFrame:
    """Return the row with the least value of the first column for each factor and site of the thesis."""
    results = []
    places = {short: site for site, short in SITES.items()}
    for (factor, short), text in thesis.items():
        own = pd.DataFrame() if rows is None else rows[(rows["site"] == places[short]) & (rows["factor"] == factor)]
        if len(own):
            least = own.loc[own[columns[0]].idxmin()]
            values = {column: least[column] for column in ("parameter", *columns)}
            results.append({"site": short, "factor": factor} | values | {name: text})
    return pd.DataFrame(results)


def _regressions(rows: pd.DataFrame | None) -> pd.DataFrame:
    results = []
    for factor, text in SIGNIFICANT_VALUES.items():
        for site, short in SITES.items():
            if "anterior" not in site or rows is None:
                continue
            own = rows[(rows["site"] == site) & (rows["factor"] == factor)].set_index("parameter")
            for name in ("scaled_mass_s2", "natural_frequency_rad_per_s"):
                if name in own.index:
                    row = own.loc[name]
                    results.append(
                        {
                            "site": short,
                            "factor": factor,
                            "parameter": name,
                            "slope": row["slope"],
                            "slope_low": row["slope_low"],
                            "slope_high": row["slope_high"],
                            "p_value": row["p_value"],
                            "thesis_p": text,
                        }
                    )
    return pd.DataFrame(results)


def _least_squares(rows: pd.DataFrame | None) -> pd.DataFrame:
    if rows is None:
        return pd.DataFrame()
    return pd.DataFrame(
        [
            {
                "site": SITES[row["site"]],
                "response": row["response"],
                "components": row["components"],
                "q_squared": row["q_squared"],
                "p_value": row["p_value"],
                "thesis": PARTIAL_LEAST_SQUARES[row["response"]][SITES[row["site"]]],
            }
            for row in rows.to_dict("records")
            if row["site"] in SITES and row["response"] in PARTIAL_LEAST_SQUARES
        ]
    )


def _subgroup(means: pd.DataFrame) -> pd.DataFrame:
    # Right-handed males of 18 to 28 years, left arm: anterior against posterior site (7.1.3).
    if not {"gender", "handedness", "age_years"} <= set(means.columns):
        return pd.DataFrame()
    age = pd.to_numeric(means["age_years"], errors="coerce")
    chosen = (means["gender"] == "male") & (means["handedness"] == "right") & age.between(_YOUNGEST, _OLDEST)
    own = means[chosen & means["site"].isin(("left anterior forearm", "left posterior forearm"))]
    side = own["site"].map({"left anterior forearm": "anterior", "left posterior forearm": "posterior"})
    rows = one_way(own.assign(site="LA, LP", side=side), "side", list(SUBGROUP))
    comparisons = []
    for row in rows.to_dict("records"):
        name = row["parameter"]
        groups = own.groupby(side)[name]
        anterior, posterior, p_value = SUBGROUP[name]
        comparisons.append(
            {
                "parameter": name,
                "subjects": int(own["subject"].nunique()),
                "anterior": groups.mean()["anterior"],
                "anterior_std": groups.std()["anterior"],
                "posterior": groups.mean()["posterior"],
                "posterior_std": groups.std()["posterior"],
                "p_value": row["p_value"],
                "thesis_anterior": anterior[0],
                "thesis_anterior_std": anterior[1],
                "thesis_posterior": posterior[0],
                "thesis_posterior_std": posterior[1],
                "thesis_p": p_value,
            }
        )
    return pd.DataFrame(comparisons)
