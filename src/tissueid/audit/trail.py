"""What one sitting, calibration or command has to say to the audit log, and in which role."""

from __future__ import annotations

import os
import threading
from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from typing import Any, Literal, get_args

from tissueid.audit.log import AuditError, AuditLog
from tissueid.errors import UnusableInputError

Role = Literal["clinician", "researcher", "technician"]
ROLES: tuple[Role, ...] = get_args(Role)
ROLE_ENVIRONMENT = "TISSUEID_ROLE"
SETTLE_S = 10.0


def role_in_force(default: Role) -> Role:
    """The role that ``TISSUEID_ROLE`` names, or else the default.

    Raises:
        UnusableInputError: it names none.
    """
    named = os.environ.get(ROLE_ENVIRONMENT, "").strip().lower()
    for role in ROLES:
        if named == role:
            return role
    if named:
        raise UnusableInputError(f"{ROLE_ENVIRONMENT} is {' or '.join(ROLES)}, not {named!r}")
    return default


@dataclass
class Trail:
    """Lines of one role. ``record`` is for what is about to begin, ``note`` for what happens while a coil may be on.

    ``head`` is that of the newest line written here; ``problem`` is why the first note that was lost could not be
    written, in one line, or empty.
    """

    log: AuditLog
    role: Role
    head: str = ""
    problem: str = ""
    _waiting: deque[tuple[partial[str], Future[str] | None]] = field(default_factory=deque, repr=False)
    _writing: bool = False
    _thread: threading.Thread | None = field(default=None, repr=False)
    _change: threading.Condition = field(default_factory=threading.Condition, repr=False)

    def record(self, what: str, *, subject: str = "", old: Any = None, new: Any = None) -> None:
        """Add a line now, after those that were noted; waits for the disk.

        Raises:
            AuditError: it cannot be written, and what it tells of must not begin.
        """
        self.ask(what, subject=subject, old=old, new=new).result()
        self._rest()

    def ask(self, what: str, *, subject: str = "", old: Any = None, new: Any = None) -> Future[str]:
        """As ``record``, for who may stop waiting: the answer is the head or the error. Lines keep their order."""
        answer: Future[str] = Future()
        self._add(what, subject, old, new, answer)
        return answer

    def note(self, what: str, *, subject: str = "", old: Any = None, new: Any = None) -> None:
        """Have a line added by a thread of its own; never waits and never raises. See ``settle``."""
        self._add(what, subject, old, new, None)

    def _add(self, what: str, subject: str, old: Any, new: Any, answer: Future[str] | None) -> None:
        with self._change:
            when: datetime = self.log.clock()
            line = partial(self.log.record, self.role, what, subject=subject, old=old, new=new, when=when)
            self._waiting.append((line, answer))
            if not self._writing:
                self._writing = True
                self._thread = threading.Thread(target=self._write_all, name="audit", daemon=True)
                self._thread.start()

    def _rest(self) -> None:
        """Leave no thread behind that has nothing more to write."""
        with self._change:
            thread = None if self._writing else self._thread
        if thread is not None:
            thread.join()

    def settle(self, timeout_s: float = SETTLE_S) -> str:
        """Wait until what was noted is written, or cannot be; returns ``problem``."""
        with self._change:
            if not self._change.wait_for(lambda: not self._writing, timeout_s) and not self.problem:
                self.problem = f"the audit log {self.log.path} stands still: the disk does not answer"
        self._rest()
        return self.problem

    def _write_all(self) -> None:
        while True:
            with self._change:
                if not self._waiting:
                    self._writing = False
                    self._change.notify_all()
                    return
                line, answer = self._waiting.popleft()
            try:
                before, self.head = self.head, line()
                if before and _number(self.head) <= _number(before):
                    self.problem = self.problem or (
                        f"lines up to {_number(before)}, which were written before: {self.log.path} was emptied, "
                        "removed or replaced while it was in use"
                    )
            except Exception as error:  # noqa: BLE001 - told to who asked, or where the trail ends; the thread goes on
                if answer is not None:
                    answer.set_exception(error)
                elif isinstance(error, AuditError):
                    self.problem = self.problem or str(error)
                else:
                    self.problem = self.problem or f"the audit log failed: {type(error).__name__}: {error}"
            else:
                if answer is not None:
                    answer.set_result(self.head)


def _number(head: str) -> int:
    return int(head.partition(":")[0])
