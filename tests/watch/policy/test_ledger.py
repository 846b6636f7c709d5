"""The log of requests: what is changed, taken out, put in or cut off is found."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armadico.core.messages import Log
from armadico.watch.assistant.keeper import LEARN_S
from armadico.watch.assistant.policy.ledger import (
    BEGIN,
    Entry,
    against,
    check,
    lines_of,
    sealed,
)
from armadico.watch.assistant.policy.messages import Approvals, Ledger
from tests.watch.test_assistant import Counter


def written(count: int) -> list[bytes]:
    lines, head = [], BEGIN
    for n in range(1, count + 1):
        entry = sealed(Entry(n, "2026-11-30T12:00:00", "asked", "model", "goto", f"{n}"), head)
        head = entry.hash
        lines.append(msgspec.json.encode(entry))
    return lines


def test_a_whole_log_is_whole() -> None:
    found = check(written(9))
    assert (found.entries, found.fault) == (9, "")
    assert not against(found, 9, found.head)
    assert not against(found, 8, "anything"), "it goes on from there"


@pytest.mark.parametrize(
    "change",
    [
        lambda lines: lines[4:5] + lines[1:],
        lambda lines: lines[:3] + lines[4:],
        lambda lines: lines[1:],
        lambda lines: [*lines[:4], lines[3], *lines[4:]],
        lambda lines: [*lines[:4], lines[5], lines[4], *lines[6:]],
        lambda lines: [*lines[:4], lines[4].replace(b"model", b"other"), *lines[5:]],
        lambda lines: [*lines[:4], b"{}", *lines[5:]],
        lambda lines: [*lines[:4], lines[4][:-9], *lines[5:]],
        lambda lines: [*lines[:4], b"\xff\xfe", *lines[5:]],
    ],
)
def test_a_log_that_was_edited_is_found(change: Callable) -> None:
    assert check(change(written(9))).fault.startswith("line ")


@given(st.data())
@settings(max_examples=50, deadline=None)
def test_any_changed_byte_is_found(data: st.DataObject) -> None:
    lines = written(4)
    number = data.draw(st.integers(0, 3))
    line = bytearray(lines[number])
    at = data.draw(st.integers(0, len(line) - 1))
    byte = data.draw(st.integers(0, 255).filter(lambda each: each != line[at]))
    line[at] = byte
    assert check([*lines[:number], bytes(line), *lines[number + 1 :]]).fault


def test_a_log_that_was_written_anew_is_found() -> None:
    whole = check(written(9))
    lines = [line.replace(b"goto", b"stop") for line in written(9)]
    forged, head = [], BEGIN
    for line in lines:
        entry = sealed(Entry(**json.loads(line)), head)
        head = entry.hash
        forged.append(msgspec.json.encode(entry))
    found = check(forged)
    assert not found.fault
    assert "anew" in against(found, whole.entries, whole.head)


def test_each_request_and_its_outcome_is_in_the_log(tmp_path: Path) -> None:
    log = tmp_path / "requests.jsonl"
    counter = Counter(log=str(log))
    counter.request("where")
    counter.request("goto", x=2, y=1)
    counter.reply_to_query(None)
    counter.request("drive")
    counter.request("stop", reason="a cat")
    entries = [json.loads(line) for line in lines_of(log)]
    assert [(e["what"], e["tool"]) for e in entries] == [
        ("started", ""),
        ("allowed", "where"),
        ("allowed", "goto"),
        ("refused", "goto"),
        ("refused", "drive"),
        ("allowed", "stop"),
    ]
    assert check(lines_of(log)).fault == ""
    assert log.stat().st_mode & 0o077 == 0, "nobody else reads or writes it"


def test_a_log_that_was_changed_stops_everything_but_a_stop(tmp_path: Path) -> None:
    log = tmp_path / "requests.jsonl"
    Counter(log=str(log)).request("goto", x=1, y=1)
    log.write_bytes(log.read_bytes().replace(b"model", b"other"))
    counter = Counter(log=str(log))
    assert "line 2 was changed" in counter.refusal("goto", x=1, y=1)
    assert not counter.queries
    counter.request("stop")
    assert counter.stops


def logged(log: Path) -> Ledger:
    """What the society remembers after three requests of a client."""
    before = Counter(log=str(log))
    before.now = LEARN_S  # nobody remembers another log
    for _ in range(3):
        before.request("where")
    return [each for each in before.published if isinstance(each, Ledger)][-1]


def test_a_log_that_was_cut_between_two_starts_is_found_and_said(tmp_path: Path) -> None:
    log = tmp_path / "requests.jsonl"
    ledger = logged(log)
    log.write_bytes(b"".join(list(lines_of(log))[:2]))
    after = Counter(log=str(log))
    after.receive(ledger)  # as the other agents restore it
    assert any("it was cut" in each.text for each in after.published if isinstance(each, Log))
    after.request("where")
    assert "cut off" in check(lines_of(log)).gap


def test_a_log_that_was_moved_away_locks_nobody_out_and_is_still_reported(tmp_path: Path) -> None:
    log = tmp_path / "requests.jsonl"
    ledger = logged(log)
    log.rename(tmp_path / "old.jsonl")
    Counter(log=str(log)).receive(ledger)
    again = Counter(log=str(log))
    assert again.refusal("where") == ""
    found = check(lines_of(log))
    assert (found.entries, found.fault) == (7, "")
    assert "line 2 is entry 5, after 1" in found.gap


def test_a_gap_before_any_other_entry_is_a_fault() -> None:
    lines = written(2)
    head = check(lines).head
    for what, faulty in (("cut", False), ("asked", True)):
        late = msgspec.json.encode(sealed(Entry(9, "", what, "model"), head))
        assert bool(check([*lines, late]).fault) == faulty


def test_a_log_that_cannot_be_written_stops_everything_but_a_stop(tmp_path: Path) -> None:
    log = tmp_path / "requests.jsonl"
    (policy := tmp_path / "policy.toml").write_text("[default]\n")
    counter = Counter(log=str(log), policy=str(policy))

    def told() -> str:
        counter.now += 1.0
        counter.agent.kernel.wake(counter.now)
        counter.collect()
        return [each for each in counter.published if isinstance(each, Approvals)][-1].policy

    assert told() == f"the policy is {policy}"
    log.unlink()
    log.mkdir()
    counter.request("where")
    assert "cannot be written" in counter.refusal("goto", x=1, y=1)
    assert told().startswith("nothing is allowed: the log ")
    counter.request("stop")
    assert counter.stops
