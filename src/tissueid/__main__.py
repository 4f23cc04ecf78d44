"""Run ``tissueid`` by ``python -m tissueid``. Prefer ``tissueid``, or ``python -P -m tissueid``.

``python -m`` puts the current folder first on the path. It is removed here before other modules are imported; modules
that Python imports before this one cannot be protected. The console script never has that folder on its path.
"""

import os
import sys

_OWN = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))  # noqa: PTH120 - pathlib is not imported yet
_FIRST = os.path.realpath(sys.path[0] or ".")
if not sys.flags.safe_path and _FIRST == os.path.realpath(".") != _OWN:
    del sys.path[0]

from tissueid.cli import main  # noqa: E402

sys.exit(main())
