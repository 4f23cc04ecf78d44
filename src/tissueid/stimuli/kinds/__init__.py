"""The kinds of stimulus, one file each."""
