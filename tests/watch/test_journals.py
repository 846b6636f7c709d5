"""Agents' journals: complete, with a gap, incomplete, begun too early, of a later format."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcap")

from msgspec import msgpack

from armadico.config.scenarios import load_scenario
from armadico.core import journal as j
from armadico.core.messages import PROTOCOL, JournalPiece, encode
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.observe.journals import Journal, Pieces
from armadico.observe.watching import Received
from armadico.watch.recorder import McapFile, Recording
from armadico.watch.recordings import Past, RecordingError
from armadico.watch.virtual_recording import Recorded

SECOND = 1_000_000_000


def run(limit: float = 3.0, path: Path | None = None) -> Rehearsal:
    options = Options(seed=5, limit=limit, sensors="ideal")
    made = Rehearsal(prepared(load_scenario("sc4"), options), options)
    if path is None:
        made.run()
    else:
        with Recorded(made.mesh, path, made.namespace):
            made.run()
    return made


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("journals") / "run.mcap"
    run(path=path)
    return path


def pieces(*entries: list[Any], instance: str = "goto-1") -> list[JournalPiece]:
    """Frames of one entry each, a piece each."""
    import zlib

    packed = [zlib.compress(msgpack.encode([entry])) for entry in entries]
    return [
        JournalPiece(instance, number, len(data).to_bytes(4, "big") + data)
        for number, data in enumerate(packed)
    ]


def read(*found: JournalPiece) -> Journal:
    collected = Pieces()
    for piece in found:
        collected.add("robot1", encode(piece), piece.number * SECOND)
    (journal,) = collected.journals()
    return journal


def head(**more: Any) -> list[Any]:
    plain = {
        "format": j.FORMAT,
        "protocol": PROTOCOL,
        "name": "goto",
        "instance": "goto-1",
        "host": "lab1",
        "pid": 7,
        "version": "1",
        "kind": "a:B",
        "parameters": {},
        "random": (3, b"", None),
        "files": {},
        "commit": "none",
        "source": "0",
    }
    return [j.START, 0.0, True, msgpack.encode(plain | more)]


def test_a_run_is_the_same_with_and_without_journals(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    kept, bare = run(path=path), run()
    assert kept.watch.path == bare.watch.path
    assert [n.agent.rng.getstate() for n in kept.mesh.nodes] == [
        n.agent.rng.getstate() for n in bare.mesh.nodes
    ]


def test_pieces_are_assembled_in_the_order_of_their_numbers() -> None:
    one, two, three = pieces(head(), [j.BEGIN, 1.0], [j.WAKE, 2.0])
    journal = read(three, one, two, one)
    assert [entry[0] for entry in journal.entries()] == [j.START, j.BEGIN, j.WAKE]


@pytest.mark.parametrize(
    ("more", "named"),
    [
        ({"format": j.FORMAT + 1}, (j.FORMAT + 1, j.FORMAT)),
        ({"protocol": PROTOCOL + 1}, (PROTOCOL + 1, PROTOCOL)),
        ({"name": 7}, ()),
    ],
)
def test_a_journal_that_cannot_be_read_has_the_reason(
    more: dict[str, Any], named: tuple[int, ...]
) -> None:
    journal = read(*pieces(head(**more)))
    assert journal.head is None
    assert journal.fault
    assert all(str(number) in journal.fault for number in named)


def test_entries_before_a_damaged_frame_are_read() -> None:
    one, two = pieces(head(), [j.BEGIN, 1.0])
    spoilt = JournalPiece("goto-1", 1, two.data[:-3] + b"???")
    entries = read(one, spoilt).entries()
    assert next(entries)[0] == j.START
    with pytest.raises(ValueError, match=r"."):
        next(entries)


@pytest.mark.parametrize(
    "entry",
    [
        [j.DELIVER, 1.0, "alarm"],
        [j.WAKE, float("nan")],
        [j.TAKE, b"\x92\x91\x00", None],
        [99, 1.0],
    ],
)
def test_entries_before_an_invalid_one_are_read(entry: list[Any]) -> None:
    journal = read(*pieces(head(), [j.BEGIN, 1.0], entry, [j.WAKE, 2.0]))
    entries = journal.entries()
    assert [next(entries)[0], next(entries)[0]] == [j.START, j.BEGIN]
    with pytest.raises(ValueError, match="entry"):
        next(entries)
    assert journal.began <= journal.offset  # computed without it


def test_a_recording_that_changes_while_it_is_read_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    run(path=path)
    goto = Past(path, pytest.fail).journals()[0]
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(ValueError, match=re.escape(str(path))):
        list(goto.entries())


def test_an_incomplete_recording_has_the_journals_up_to_its_end(
    recording: Path, tmp_path: Path
) -> None:
    cut, warnings = tmp_path / "cut.mcap", list[str]()
    data = recording.read_bytes()
    cut.write_bytes(data[: len(data) * 2 // 3])
    found = Past(cut, warnings.append).journals()
    assert any(str(cut) in text for text in warnings)
    assert len(found) >= 7
    assert all(journal.frames and not journal.fault for journal in found)


def test_a_recording_of_several_files_is_read_as_one(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    kept = Recording(path, max_bytes=1)
    for piece in pieces(head(), [j.BEGIN, 1.0], [j.WAKE, 2.0]):
        kept.add(Received("robot1", f"journal/{piece.instance}", encode(piece), piece.number))
        kept.flush()
    kept.close()
    past = Past(path, pytest.fail)
    assert len(past.paths) == 4
    (journal,) = past.journals()
    assert len([*journal.frames]) == 3


def test_a_recording_of_another_program_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    McapFile(path, {}, "ros2").close()
    with pytest.raises(RecordingError, match="armadico record"):
        Past(path, pytest.fail).check()
