"""Effects that a recording may contain and the baseline twin does not model: one file each."""
