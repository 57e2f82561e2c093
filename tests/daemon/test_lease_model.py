"""Compare the socket server with a small model for random sequences of client requests (stateful tests).

The model contains the holder of the set-point, the end of the lease, the active value, and the permissions. Its clients
are the user who started the daemon, a member of the command group, and a member of the watch group.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import pytest
from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule, run_state_machine_as_test

from tests.daemon.test_lease import COMMAND, SET_POINT, WATCH, Desk, Talk
from tsa_ctrl.ipc.mailbox import RECOVER

SILENT = 0.2  # s for which a value is active if its client has not requested a lease
WHO = st.sampled_from(["owner", "member", "watcher"])
GROUPS: dict[str, tuple[int, ...]] = {"owner": (), "member": (COMMAND,), "watcher": (WATCH,)}


class Model(RuleBasedStateMachine):
    """Random requests, the expected answers and the expected state."""

    @initialize()
    def begin(self) -> None:
        self.patch = pytest.MonkeyPatch()
        self.folder = tempfile.TemporaryDirectory(prefix="lease-")
        self.desk = Desk(Path(self.folder.name), self.patch)
        self.desk.wanted()
        self.clients: dict[str, Talk] = {}
        self.holder: str | None = None
        self.seconds = 0.0
        self.silent = True  # the holder has not requested a lease
        self.until = -math.inf
        self.value: float | None = None  # None if withdrawn

    def talk(self, who: str) -> Talk:
        if who not in self.clients:
            self.clients[who] = self.desk.client(*GROUPS[who])
        return self.clients[who]

    def free(self, who: str) -> bool:
        return self.holder in (None, who)

    def withdraw(self) -> None:
        self.holder, self.silent, self.value = None, True, None

    @rule(who=WHO, seconds=st.sampled_from([0.05, 0.3, 2.0, 0.019, 10.1, 1e300]))
    def lease(self, who: str, seconds: float) -> None:
        may = who != "watcher" and self.free(who) and 0.02 <= seconds <= 10.0
        assert self.talk(who).ask("lease", seconds=seconds)["ok"] is may
        if may:
            self.holder, self.seconds, self.silent, self.until = who, seconds, False, self.desk.now + seconds

    @rule(who=WHO, value=st.sampled_from([-0.5, 0.0, 0.25]))
    def want(self, who: str, value: float) -> None:
        may = who != "watcher" and self.free(who)
        assert self.talk(who).ask(**SET_POINT, value=value)["ok"] is may
        if may:
            if self.silent:
                self.holder, self.seconds = who, SILENT
            self.value, self.until = value, self.desk.now + self.seconds

    @rule(who=WHO)
    def release(self, who: str) -> None:
        self.talk(who).ask("release")
        if self.holder == who:
            self.withdraw()

    @rule(who=WHO)
    def disconnect(self, who: str) -> None:
        if who in self.clients:
            self.clients.pop(who).socket.close()
            self.desk.steps()
            if self.holder == who:
                self.withdraw()

    @rule(seconds=st.sampled_from([0.01, 0.06, 0.21, 2.5]))
    def wait(self, seconds: float) -> None:
        self.desk.now += seconds
        self.desk.steps()
        if self.holder is not None and self.desk.now > self.until:
            self.withdraw()

    @rule(who=WHO)
    def recover(self, who: str) -> None:
        """Request a recovery. Only the user who started the daemon and the holder of a lease are permitted."""
        self.desk.fault()
        may = who == "owner" or (who == "member" and self.holder == who and not self.silent)
        while self.desk.mailbox.take() is not None:
            pass
        self.talk(who).say(verb="recover")
        self.talk(who).told()
        command = self.desk.mailbox.take()
        assert (command is not None and command.parameter == RECOVER) is may

    @rule(
        who=WHO, line=st.sampled_from([b"[" * 2000 + b"\n", b"{}\n", b'{"verb": "lease", "seconds": NaN}\n', b"\xff\n"])
    )
    def nonsense(self, who: str, line: bytes) -> None:
        """Send an invalid request, which changes nothing."""
        self.talk(who).socket.sendall(line)
        self.talk(who).told()

    @invariant()
    def what_is_wanted_is_its_owners(self) -> None:
        found = self.desk.wanted()
        if found is None:
            return
        if self.value is None:
            assert found == (0.0, -math.inf), "a value of nobody"
        else:
            assert found[0] == self.value

    @invariant()
    def the_status_names_who_holds_it(self) -> None:
        told = self.desk.server._lease.holder
        assert (told is None) is (self.holder is None)

    def teardown(self) -> None:
        if hasattr(self, "desk"):
            self.desk.close()
            self.patch.undo()
            self.folder.cleanup()


def test_the_server_and_its_model_agree() -> None:
    quick = settings(
        max_examples=24, stateful_step_count=20, deadline=None, database=None, derandomize=True,
        phases=(Phase.generate, Phase.shrink),
    )  # fmt: skip
    run_state_machine_as_test(Model, settings=quick)
