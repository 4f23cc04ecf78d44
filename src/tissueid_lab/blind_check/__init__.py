"""Blind check of the diagnosis: scenarios with sealed labels, answers, scores, and the fit of the thresholds."""
