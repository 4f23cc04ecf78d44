"""Audit trail of one sitting, calibration or command: its lines in the audit log, written by a thread."""

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
from tissueid.language import marked
from tissueid.messages import Message, Verbatim, joined

Role = Literal["clinician", "researcher", "technician"]
ROLES: tuple[Role, ...] = get_args(Role)
ROLE_ENVIRONMENT = "TISSUEID_ROLE"
SETTLE_S = 10.0
"""Longest wait for lines that are being written, s."""


def active_role(default: Role) -> Role:
    """Return the role in ``TISSUEID_ROLE``, or the default without one.

    Raises:
        UnusableInputError: the variable names no role.
    """
    named = os.environ.get(ROLE_ENVIRONMENT, "").strip().lower()
    for role in ROLES:
        if named == role:
            return role
    if named:
        raise UnusableInputError(
            "audit.role",
            "{variable} must be {roles}, not '{value}'",
            variable=ROLE_ENVIRONMENT,
            roles=joined(ROLES, last=marked(" or ")),
            value=Verbatim(named),
        )
    return default


@dataclass
class AuditTrail:
    """Lines of one role. Use ``record`` before an action, and ``note`` while the coil may be energised.

    ``head`` is the head of the newest line written here. ``problem`` is the reason why the first lost note could not
    be written; empty without one.
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
        """Add a line after the noted ones, and wait for the disk.

        Raises:
            AuditError: writing failed; the action must not begin.
        """
        self.submit(what, subject=subject, old=old, new=new).result()
        self._join_idle()

    def submit(self, what: str, *, subject: str = "", old: Any = None, new: Any = None) -> Future[str]:
        """Add a line as ``record`` does, without waiting: the future gives its head or the error."""
        answer: Future[str] = Future()
        self._add(what, subject, old, new, answer)
        return answer

    def note(self, what: str, *, subject: str = "", old: Any = None, new: Any = None) -> None:
        """Add a line in the background. Never waits and never raises; see ``settle``."""
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

    def _join_idle(self) -> None:
        """Join a thread that has nothing more to write."""
        with self._change:
            thread = None if self._writing else self._thread
        if thread is not None:
            thread.join()

    def settle(self, timeout_s: float = SETTLE_S) -> str:
        """Wait until all notes are written or have failed; return ``problem``."""
        with self._change:
            if not self._change.wait_for(lambda: not self._writing, timeout_s) and not self.problem:
                self.problem = Message(
                    "audit.no_answer",
                    "writing to the audit log {path} takes too long: the disk does not answer",
                    path=str(self.log.path),
                )
        self._join_idle()
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
                    self.problem = self.problem or Message(
                        "audit.replaced",
                        "lines up to {line}, which were written before: {path} was emptied, removed or replaced while "
                        "it was in use",
                        line=_number(before),
                        path=str(self.log.path),
                    )
            except Exception as error:  # noqa: BLE001 - reported by the future or by settle(); the thread continues
                if answer is not None:
                    answer.set_exception(error)
                elif isinstance(error, AuditError):
                    self.problem = self.problem or error.message
                else:
                    self.problem = self.problem or Message(
                        "audit.failed",
                        "the audit log failed: {kind}: {why}",
                        kind=type(error).__name__,
                        why=str(error),
                    )
            else:
                if answer is not None:
                    answer.set_result(self.head)


def _number(head: str) -> int:
    return int(head.partition(":")[0])
