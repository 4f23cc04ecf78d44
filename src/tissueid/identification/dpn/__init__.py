"""Dynamic parameter nonlinearity: mass, damping and stiffness as functions of depth."""
