"""``python -m firmware_sim.laboratory``: generate scenarios and write their records."""

from firmware_sim.laboratory.scenario_generation import main

raise SystemExit(main())
