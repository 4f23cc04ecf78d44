"""``python -m tissueid`` is ``tissueid``."""

import sys

from tissueid.cli import main

sys.exit(main())
