"""Measures what the stimuli promise and writes docs/measured/stimuli.json.

Without options it prints them; ``--write`` puts them there, a section for each topic; ``--only TOPIC``
measures one topic, which is a module of ``stimulus_claims``. Status 1 when a claim is not kept.
"""

from __future__ import annotations

import sys

from measured import Measured

if __name__ == "__main__":
    sys.exit(Measured("stimulus_claims", "stimuli").main(__doc__))
