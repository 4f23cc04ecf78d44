"""``python -m firmware_sim.laboratory``: draw scenarios and write their records."""

from firmware_sim.laboratory.drawing import main

raise SystemExit(main())
