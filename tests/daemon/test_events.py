"""What happened, in the room that the mailbox has: the first fault, which is the cause, is never what is left out."""

from __future__ import annotations

import json

from tsa_ctrl.daemon.events import MOST, Events
from tsa_ctrl.ipc.mailbox import TEXT
from tsa_ctrl.safety.causes import Cause


def test_the_cause_is_kept_beside_the_newest_however_long_they_are() -> None:
    events = Events()
    events.add(0.0, "", "before")
    events.add(1.0, "knee", "the cause", cause=Cause.SKIPPED)
    for n in range(3 * MOST):
        events.add(2.0 + n, "hip", f"{n} " + "x" * 900, cause=Cause.SKIPPED if n % 2 == 0 else None)
    text = events.encoded()
    kept = json.loads(text)
    assert len(text) <= TEXT
    assert kept[0]["text"] == "the cause"
    assert [event["number"] for event in kept[1:]] == list(range(3 * MOST + 3 - len(kept), 3 * MOST + 2))
    assert len(kept) > 10
    assert events.first_fault is not None
    assert events.first_fault.text == "the cause"
