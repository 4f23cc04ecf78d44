"""Effects that a recording can contain and the baseline twin does not model: one file each."""
