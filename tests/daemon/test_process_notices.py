"""Test that a hanging process and its replacement are each reported once and in time."""

from __future__ import annotations

from tsa_ctrl.daemon.notices import Events, ProcessNotices

STATUS = 0.02  # s between two checks by the loop


class Process:
    """The values of a process in shared memory. The log time of the loop begins at 100 s."""

    def __init__(self) -> None:
        self.heard = 0.0
        self.replaced = 0
        self.events = Events()
        self.alive = True
        self.notices = ProcessNotices(
            "log", lambda: self.alive, lambda: self.heard, lambda: self.replaced, "hang", "on", "gone"
        )

    def until(self, begin: float, end: float, beats: bool) -> None:
        for look in range(round((end - begin) / STATUS)):
            now = begin + look * STATUS
            self.heard = now if beats else self.heard
            self.notices.update(now - 100.0, now, self.events)

    @property
    def said(self) -> list[tuple[float, str]]:
        return [(event.t, event.text) for event in self.events.all]


def test_hanging_process_is_said_once_and_within_two_seconds_unless_it_has_not_begun() -> None:
    process = Process()
    process.until(90.0, 100.0, beats=False)
    process.until(100.0, 110.0, beats=True)
    assert process.said == []
    process.until(110.0, 120.0, beats=False)
    ((t, text),) = process.said
    assert 10.0 < t < 12.0
    assert "log: its process hangs" in text
    assert process.notices.silent > 8.0


def test_process_that_comes_back_or_is_replaced_is_said_and_may_hang_again() -> None:
    process = Process()
    process.until(100.0, 101.0, beats=True)
    process.until(101.0, 104.0, beats=False)
    process.until(104.0, 105.0, beats=True)
    process.until(105.0, 108.0, beats=False)
    assert [text.split(",")[0] for _, text in process.said] == [
        "log: its process hangs",
        "log: its process answers again",
        "log: its process hangs",
    ]
    other = Process()
    other.until(100.0, 101.0, beats=True)
    other.replaced = 1
    other.until(101.0, 102.0, beats=True)
    ((_, text),) = other.said
    assert "another one took over" in text


def test_process_that_has_ended_is_said_once_and_does_not_hang() -> None:
    process = Process()
    process.until(100.0, 101.0, beats=True)
    process.alive = False
    process.until(101.0, 105.0, beats=False)
    assert [text for _, text in process.said] == ["log: its process is gone; gone"]
    assert process.notices.silent == 0.0
