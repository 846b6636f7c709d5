"""The log of requests as the assistant agent keeps it: its file, and what the society remembers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

from armadico.core.agent import ERROR
from armadico.core.messages import Message, line
from armadico.watch.assistant.messages import AssistantRequest
from armadico.watch.assistant.policy import approvals
from armadico.watch.assistant.policy.ledger import CUT, Entry, LogFile
from armadico.watch.assistant.policy.messages import Ledger

MOVE: Final = "a person has to look at it, and to move it away"


class Book:
    """Appends to the log, publishes its end, and ends approvals that the log does not prove."""

    def __init__(
        self,
        path: str,
        known: approvals.Approvals,
        *,
        by: str,
        hears: Callable[[], bool],
        stamp: Callable[[], str],
        publish: Callable[[Message], None],
        log: Callable[[str, int], None],
    ) -> None:
        """Open the log, and take its approvals for always as not proved yet.

        Without a path there is no log. `by` is the instance that writes; `hears` returns whether
        the society may still tell what it knows of the log; `stamp` returns the local time with its
        offset, ISO 8601; `log` logs a line for people at a level.
        """
        # Why the log cannot be used, so that nothing is allowed; "": it can, or there is none.
        self.fault = ""
        self._path, self._approvals, self._by = path, known, by
        self._hears, self._stamp, self._publish, self._log = hears, stamp, publish, log
        self._file: LogFile | None = None
        self._unheard = True  # whether the society has not said yet what it knows of the log
        if not path:
            return
        try:
            file = LogFile(Path(path))
        except OSError as error:
            self.fault = f"the log {path} cannot be read: {error.strerror}"
            return
        if file.known.fault:
            self.fault = f"the log {path}: {file.known.fault}; {MOVE}"
            return
        self._file = file
        self._approvals.unproved = approvals.read(file.known.always)

    def write_of(
        self, request: AssistantRequest, what: str, why: str = "", mission: int = 0
    ) -> None:
        """Append what became of a request."""
        self.write(what, request.asker, request.tool, request.text, why, mission)

    def write(
        self, what: str, by: str, tool: str = "", text: str = "", why: str = "", mission: int = 0
    ) -> None:
        """Append an entry. If that fails, nothing is allowed any more."""
        if self._file is None:
            return
        try:
            self._file.append(Entry(0, self._stamp(), what, by, tool, text, why, mission))
        except OSError as error:
            self.fault = f"the log {self._path} cannot be written: {error.strerror}"
            self._log(line(self.fault), ERROR)
            self._file = None
            return
        self.publish()

    def publish(self) -> None:
        """Publish the log's end, once that of the society is known: it would replace it."""
        self.end_hearing()
        if self._file is not None and not self._unheard:
            self._publish(Ledger(self._file.known.entries, self._file.known.head))

    def end_hearing(self) -> None:
        """The log's approvals never count if the society has told nothing of it in time.

        From then on this agent publishes the log's end: it would hear its own word.
        """
        if self._file is not None and self._unheard and not self._hears():
            self._unheard = False
            self._approvals.lapse()
            self._write_gap(self._file.unheard())

    def hear(self, ledger: Ledger) -> None:
        """Find a log that was changed while this agent was away: the others remember its end."""
        if self._file is None:
            return
        self._unheard = False
        found, late = self._file.hear(ledger.counter, ledger.head)
        if found is not None and found.what == CUT:
            self._approvals.lapse()
        self._approvals.prove(without=approvals.read(late))
        self._write_gap(found)

    def _write_gap(self, found: Entry | None) -> None:
        """Write what is wrong with the log into it."""
        if found is not None:
            self._log(line(found.why), ERROR)
            self.write(found.what, by=self._by, text=found.text, why=found.why)
