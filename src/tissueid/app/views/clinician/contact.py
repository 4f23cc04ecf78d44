"""Contact of the probe with the skin during a test."""

from __future__ import annotations

import numpy as np

from tissueid.acquisition.contact import MARGIN_M, RECENT_S, Contact, contact_at, finite
from tissueid.acquisition.playback import Phase
from tissueid.app.live_signals import Snapshot
from tissueid.device import DeviceDescription


def contact_in_test(snapshot: Snapshot, device: DeviceDescription) -> Contact:
    """Return the contact during a test."""
    if snapshot.phase is None:
        return Contact.FINDING
    if snapshot.phase is Phase.RELEASE:
        return Contact.UNWATCHED
    newest = snapshot.time_s[-1:] - RECENT_S
    position = finite(snapshot.position_m[snapshot.time_s >= newest]) if newest.size else np.zeros(0)
    if snapshot.phase is Phase.PLACE:
        found = contact_at(position, device.stroke_m) if position.size else Contact.FINDING
        return Contact.FINDING if found is Contact.MOVING else found
    safety = snapshot.safety
    if safety is None or safety.contact is None:
        return Contact.FINDING
    if not safety.contact:
        return Contact.OFF
    if position.size and float(position.max()) > safety.limits.max_position_m - MARGIN_M:
        return Contact.TOO_DEEP
    return Contact.ON
