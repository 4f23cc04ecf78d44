"""Measures what the stimuli promise and writes the tables of docs/stimuli.md.

Without options it prints them; ``--write`` puts them into the document, a table for each topic; ``--only TOPIC``
measures one topic, which is a module of ``stimulus_claims``. Status 1 when a claim is not kept.
"""

from __future__ import annotations

import sys

from measured import HERE, Measured

if __name__ == "__main__":
    sys.exit(Measured("stimulus_claims", HERE.parent / "stimuli.md").main(__doc__))
