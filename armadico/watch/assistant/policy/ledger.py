"""The log of requests: lines of JSON, each with the hash of all before it.

A line that was changed, taken out or put in breaks the chain. A log that was cut at its end is
whole in itself, so the society keeps its length and its last hash as a latched state (`Ledger`).
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Final

import msgspec
from msgspec import Struct

BEGIN: Final = "0" * 64
"""The hash before the first line."""

CUT: Final = "cut"
"""What an entry says that was written after a gap."""

ALWAYS: Final = "always"
"""What one says with an approval for always; its reason is that, as JSON."""

FORGOTTEN: Final = "forgotten"
"""What one says that ends those of a client, which is its text."""

BEYOND: Final = "beyond"
"""What one says that ends those that the society did not know: after the entry of its text."""

LAST: Final = 64
"""So many approvals for always count; for what an older one allowed people are asked again."""

OTHERS: Final = 0o022
"""The bits of a file's mode by which others than its owner write."""


class Entry(Struct, frozen=True, forbid_unknown_fields=True):
    """One line of the log."""

    n: int  # from 1
    at: str  # local time with its offset, ISO 8601
    what: str  # asked, allowed, refused, waits, approved, denied, ... (docs/policy.md)
    by: str  # the client: its identity, and as it calls itself; or the person
    tool: str = ""
    text: str = ""  # the arguments as they came
    why: str = ""  # the reply, the refusal or the reason
    mission: int = 0
    hash: str = ""  # of the line before, and this one without it


def sealed(entry: Entry, before: str) -> Entry:
    """The entry with its hash, after one with the hash `before`."""
    bare = msgspec.structs.replace(entry, hash="")
    return msgspec.structs.replace(
        bare, hash=sha256(before.encode() + msgspec.json.encode(bare)).hexdigest()
    )


@dataclass(frozen=True)
class Checked:
    """What is known of a log."""

    entries: int = 0  # the number of its last line; 0: it is empty
    head: str = BEGIN  # the last line's hash
    fault: str = ""  # what is wrong, and in which line; "": the chain holds
    # Where entries are missing, by a line that says so itself; "": nowhere. It is no fault, since
    # the agent wrote that line, and a log that was moved away begins with one.
    gap: str = ""
    # The approvals for always that count. None from before a gap does, since what ended it may have
    # been cut off.
    always: tuple[Entry, ...] = ()


def check(lines: Iterable[bytes]) -> Checked:
    """Check the chain of the lines of a log."""
    found = Checked()
    for number, line in enumerate(lines, 1):
        try:
            entry = msgspec.json.decode(line, type=Entry)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            return replace(found, fault=f"line {number} is no entry: {error}")
        if sealed(entry, found.head) != entry or msgspec.json.encode(entry) != line.rstrip(b"\n"):
            return replace(
                found, fault=f"line {number} was changed, or one before it was taken out or put in"
            )
        gap = ""
        if entry.n != found.entries + 1:
            gap = f"line {number} is entry {entry.n}, after {found.entries}: those between were cut"
            gap = f"{gap} off before it was written"
            if entry.what != CUT or entry.n <= found.entries:
                return replace(found, fault=gap)
        elif entry.what == CUT:
            gap = f"line {number} says: {entry.why}"
        always = () if gap else found.always
        if entry.what == ALWAYS:
            always = (*always, entry)[-LAST:]
        elif entry.what == BEYOND:
            known = int(entry.text) if entry.text.isdecimal() else 0
            always = tuple(each for each in always if each.n <= known)
        elif entry.what == FORGOTTEN:
            always = tuple(each for each in always if each.by != entry.text)
        found = Checked(entry.n, entry.hash, gap=found.gap or gap, always=always)
    return found


def against(found: Checked, entries: int, head: str) -> str:
    """Why a log is not the one that the society knows, of so many entries; "" if it is.

    A log that goes on from there is.
    """
    if found.entries < entries:
        return f"it has {found.entries} entries, and the society knows {entries}: it was cut"
    if found.entries == entries and found.head != head:
        return f"entry {entries} is not the one that the society knows: it was written anew"
    return ""


class LogFile:
    """A log on disk, which is only appended to."""

    def __init__(self, path: Path) -> None:
        """Check what is there. Raises OSError."""
        self.path = path
        self.known = check(lines_of(path)) if path.exists() else Checked()  # what is known of it
        self.skip = 0  # entries that the society knows and the file has lost
        if path.exists() and (fault := exposed(path)):
            self.known = Checked(fault=fault)

    def append(self, entry: Entry) -> Checked:
        """Append an entry; its `n` and `hash` are set here. Raises OSError."""
        number = max(self.known.entries, self.skip) + 1
        entry = sealed(msgspec.structs.replace(entry, n=number), self.known.head)
        descriptor = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
        try:
            os.write(descriptor, msgspec.json.encode(entry) + b"\n")
        finally:
            os.close(descriptor)
        self.known = replace(self.known, entries=number, head=entry.hash)
        return self.known

    def hear(self, entries: int, head: str) -> tuple[Entry | None, tuple[Entry, ...]]:
        """Compare the file with what the society knows, the number of entries and the last hash.

        If they differ, return the entry to append, `CUT`, after which no approval for always
        counts, or `BEYOND`; and the approvals beyond what the society knows, which count no more.
        """
        if self.skip and entries <= self.skip:
            return None, ()
        if why := self._differs(entries, head):
            self.skip = entries
            return Entry(0, "", CUT, "", why=f"the log {self.path} was changed: {why}"), ()
        late = tuple(each for each in self.known.always if each.n > entries)
        why = f"the society knows {entries} entries of the log {self.path}"
        return self._beyond(entries, late, why), late

    def unheard(self) -> Entry | None:
        """The society tells nothing of the log: the entry to append, if it has approvals.

        None of them counts any more: whoever can write the file may have added them.
        """
        why = f"nobody has told what the society knows of the log {self.path}"
        return self._beyond(0, self.known.always, why)

    def _beyond(self, entries: int, late: tuple[Entry, ...], why: str) -> Entry | None:
        """The entry that ends approvals for always which come after so many entries."""
        if not late:
            return None
        kept = tuple(each for each in self.known.always if each not in late)
        self.known = replace(self.known, always=kept)
        why = f"{why}, and {len(late)} approvals for always come after that: they do not count"
        return Entry(0, "", BEYOND, "", text=str(entries), why=why)

    def _differs(self, entries: int, head: str) -> str:
        """Why the file is not the log that the society knows, of so many entries; "" if it is."""
        if fault := against(self.known, entries, head):
            return fault
        # Entries that are missing here are in a gap, which the file tells itself.
        try:
            for line in lines_of(self.path) if entries < self.known.entries else ():
                entry = msgspec.json.decode(line, type=Entry)
                if entry.n == entries:
                    return against(Checked(entry.n, entry.hash), entries, head)
        except (OSError, msgspec.DecodeError) as error:
            return f"it cannot be read any more: {error}"
        return ""


def exposed(path: Path) -> str:
    """Why others than this user could have written a log; "" if they could not. Raises OSError."""
    found = path.stat()
    if found.st_uid != os.geteuid():
        return f"it is not of this user: it is owned by {found.st_uid}"
    if found.st_mode & OTHERS:
        return f"others can write it (mode {found.st_mode & 0o777:04o}): it has to be 0600"
    return ""


def lines_of(path: Path) -> Iterator[bytes]:
    """The lines of a log. Raises OSError."""
    with path.open("rb") as file:
        yield from file
