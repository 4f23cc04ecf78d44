"""Measures what the instrument promises and writes docs/measured/instrument.json.

Without options it prints them; ``--write`` puts them there, a section for each topic; ``--only TOPIC``
measures one topic, which is a module of ``instrument_claims``. Status 1 when a claim is not kept.
"""

from __future__ import annotations

import sys

from measured import Measured

if __name__ == "__main__":
    sys.exit(Measured("instrument_claims", "instrument").main(__doc__))
