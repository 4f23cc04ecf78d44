"""Measures what the instrument promises and writes the tables of docs/instrument.md.

Without options it prints them; ``--write`` puts them into the document, a table for each topic; ``--only TOPIC``
measures one topic, which is a module of ``instrument_claims``. Status 1 when a claim is not kept.
"""

from __future__ import annotations

import sys

from measured import HERE, Measured

if __name__ == "__main__":
    sys.exit(Measured("instrument_claims", HERE.parent / "instrument.md").main(__doc__))
