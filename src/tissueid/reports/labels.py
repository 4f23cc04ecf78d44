"""Names of quantities that reports look up by the name of a parameter, marked for the catalogue."""

from tissueid.language import marked

PARAMETERS = (
    marked("Natural frequency"),
    marked("Damping ratio"),
)
"""Labels that :func:`tissueid.wording.named_unit` makes of names of parameters."""
