"""The recorder: recordings can be read, also after a kill and if the file is damaged."""

from __future__ import annotations

import csv
import json
import resource
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import defstruct

pytest.importorskip("mcap")

from mcap.reader import make_reader

from armadico import cli
from armadico.cli import options
from armadico.core import messages as m
from armadico.core.services import services
from armadico.launch.virtual_session import VirtualSession
from armadico.mesh.virtual import VirtualMesh
from armadico.mobile.messages import Echo, Pose, Sonar
from armadico.observe.watching import (
    Presence,
    Received,
    as_object,
    from_object,
    json_schema,
)
from armadico.watch.commands import record as command
from armadico.watch.export import Tables, to_rrd
from armadico.watch.mcap_records import MAGIC
from armadico.watch.recorder import TRIES, Gaps, McapFile, Recording, record
from armadico.watch.recordings import RecordingError, Row, rows
from tests.programs import call

CYCLE = m.Cycle(2**62 + 1, 7)
BALLOT = m.Ballot(3, 0.6, False, "goto-1")
POSE = Pose(CYCLE, 1.5, -2.0, 0.25)
CLAIM = m.Claim("wheels", BALLOT, CYCLE, 0.6, False, (0.3, 0.1), (0.2, 0.0))
SONAR = Sonar(CYCLE, 5.0, (Echo(0.1, 0.2, 0.3, None), Echo(0.1, 0.2, 0.3, 2.0)))
STATE = m.RobotState(CYCLE, 1, 2, 3, 0.5, 0, 12.5, True, False)
RELEASE = m.Command("wheels", CYCLE, BALLOT, None)
ENCODED = m.Claim("arm", BALLOT, CYCLE, 0.6, wanted=b"\x00\xff", commanded=b"")
CARD = m.Card("goto", "goto-1", "lab1", 7, "1", 1, ("a",), ("b",), ("wheels",))
SECOND = 1_000_000_000
MEMORY = 1_000_000_000


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.mcap"


def received(key: str, message: m.Message, at: int = 0, *, on_query: bool = False) -> Received:
    return Received("robot1", key, m.encode(message), at, on_query)


def test_two_kinds_of_one_name_keep_their_own_schemas(path: Path) -> None:
    file = McapFile(path, {})
    kinds = [defstruct("Alarm", [(field, float)]) for field in ("volts", "metres")]
    for number, kind in enumerate(kinds):
        file.add("robot1", f"alarm/{number}", kind, b"{}", 0)
    file.close()
    with path.open("rb") as stream:
        found = {c.topic: s.data for s, c, _ in make_reader(stream).iter_messages() if s}
    assert b"volts" in found["/robot1/alarm/0"]
    assert b"metres" in found["/robot1/alarm/1"]


def bid(number: int) -> m.BidRecord:
    return m.BidRecord(m.Cycle(1, number), "wheels", 0.5, False, (0.1, 0.2), "", ("encoder/pose",))


def recorded(path: Path, *items: Received | Presence, **options: Any) -> Recording:
    recording = Recording(path, **options)
    for item in items:
        recording.add(item)
        recording.flush()
    recording.close()
    return recording


def read(path: Path) -> list[Row]:
    warnings: list[str] = []
    found = list(rows(path, warnings.append))
    assert not warnings
    return found


@pytest.mark.parametrize(
    "message",
    [CLAIM, SONAR, CARD, RELEASE, ENCODED],
    ids=lambda m: type(m).__name__,
)
def test_a_message_is_the_same_after_being_an_object(message: m.Message) -> None:
    plain = json.loads(json.dumps(as_object(message)))
    assert from_object(type(message), plain) == message


@pytest.mark.parametrize("service", services(), ids=lambda s: s.key)
def test_every_message_has_a_schema_that_viewers_read(service: Any) -> None:
    def check(schema: dict[str, Any]) -> None:
        assert schema["type"] in {"object", "array", "string", "number", "integer", "boolean"}
        assert not {"$ref", "anyOf", "oneOf"} & set(schema)
        for inner in (*schema.get("properties", {}).values(), schema.get("items")):
            if inner is not None:
                check(inner)

    schema = json_schema(service.reply or service.message)
    assert schema["type"] == "object"
    check(schema)


def test_an_encoded_action_is_hexadecimal_text_in_a_separate_field() -> None:
    found = as_object(ENCODED)
    assert (found["wanted_hex"], found["commanded_hex"]) == ("00ff", "")
    assert not {"wanted", "commanded"} & set(found)
    schema = json_schema(m.Claim)["properties"]
    assert schema["wanted"] == {"type": "array", "items": {"type": "number"}}
    assert schema["wanted_hex"] == {"type": "string"}
    with pytest.raises(m.MessageError):
        from_object(m.Claim, found | {"wanted_hex": "not hexadecimal"})


def test_other_readers_find_schemas_and_an_index(path: Path) -> None:
    recorded(path, received("encoder/pose", POSE, 5))
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        (channel,) = summary.channels.values()
        schema = summary.schemas[channel.schema_id]
        assert (channel.message_encoding, schema.encoding) == ("json", "jsonschema")
        assert json.loads(schema.data)["properties"]["x"] == {"type": "number"}
        assert summary.chunk_indexes
        ((_, _, message),) = make_reader(stream).iter_messages()
        assert json.loads(message.data)["x"] == POSE.x


def test_unknown_and_invalid_payloads_are_recorded_raw(path: Path) -> None:
    strange = Received("robot1", "other/key", b"\x01\x02", 1)
    broken = Received("robot1", "encoder/pose", b"\xff", 2)
    recording = recorded(path, strange, broken)
    assert recording.refused == 1
    assert [(row.key, row.schema, row.data) for row in read(path)] == [
        ("other/key", "", b"\x01\x02"),
        ("encoder/pose.refused", "", b"\xff"),
    ]


def test_repeated_tokens_and_cards_are_recorded_once(path: Path) -> None:
    came = Presence("robot1", "goto", "goto-1", True, 1)
    gone = Presence("robot1", "goto", "goto-1", False, 2)
    card = received("agent/goto/goto-1/card", CARD, 1, on_query=True)
    recorded(path, came, came, card, card, gone, gone)
    assert [(row.key, row.fields.get("there")) for row in read(path)] == [
        ("agent/goto/goto-1", True),
        ("agent/goto/goto-1/card", None),
        ("agent/goto/goto-1", False),
    ]


def test_each_bid_of_overlapping_histories_is_recorded_once(path: Path) -> None:
    key = "agent/goto/goto-1/bids"
    answers = [
        received(key, m.BidHistory("goto-1", tuple(map(bid, numbers))), on_query=True)
        for numbers in ((1, 2, 3), (2, 3, 4), (2, 3, 4), (9,))
    ]
    recorded(path, *answers)
    assert [row.message for row in read(path)] == [bid(n) for n in (1, 2, 3, 4, 9)]


def test_each_file_of_a_recording_can_be_read_alone(tmp_path: Path, path: Path) -> None:
    came = Presence("robot1", "goto", "goto-1", True, 1)
    card = received("agent/goto/goto-1/card", CARD, 1, on_query=True)
    poses = [received("encoder/pose", POSE, n) for n in range(80)]
    recording = recorded(path, came, card, *poses, max_bytes=5000)
    assert recording.files >= 3
    files = [path, *sorted(tmp_path.glob("run-*.mcap"))]
    assert len(files) == recording.files
    for file in files:
        assert {row.key for row in read(file)} >= {"agent/goto/goto-1", "agent/goto/goto-1/card"}
    kept = [row.t for file in files for row in read(file) if row.key == "encoder/pose"]
    assert kept == list(range(80))


class Crowd:
    """A watcher that receives messages without pause."""

    def __init__(self) -> None:
        self.count = 0

    def get(self, _: float) -> Received:
        self.count += 1
        return received("encoder/pose", POSE, self.count)

    def subscribe(self) -> None: ...

    watch_alive = subscribe


def test_a_recording_ends_between_two_messages(tmp_path: Path) -> None:
    crowd: Any = Crowd()
    recording = Recording(tmp_path / "run.mcap")
    record(crowd, recording, lambda _: None, over=lambda: crowd.count == 7)
    recording.close()
    assert len(read(recording.path)) == 7


def test_flushed_messages_are_read_wherever_the_file_ends(tmp_path: Path) -> None:
    path, cut = tmp_path / "run.mcap", tmp_path / "cut.mcap"
    recording = Recording(path)
    sizes = []
    for n in range(5):
        recording.add(received("encoder/pose", POSE, n))
        recording.flush()
        sizes.append(path.stat().st_size)
    data = path.read_bytes()
    recording.close()
    for length in range(sizes[0], len(data), 7):
        cut.write_bytes(data[:length])
        warnings: list[str] = []
        found = [row.t for row in rows(cut, warnings.append)]
        flushed = sum(size <= length for size in sizes)
        assert found[:flushed] == list(range(flushed))
        assert str(cut) in warnings[0]


@given(st.binary(max_size=200))
def test_another_file_is_no_recording(
    tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    path = tmp_path_factory.mktemp("bad") / "bad.mcap"
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=r"bad\.mcap"):
        raise RecordingError(f"{list(rows(path, raising))}")


def raising(text: str) -> None:
    raise RecordingError(text)


@given(st.integers(0, 4000), st.integers(1, 255))
def test_a_damaged_byte_is_reported_and_what_precedes_it_is_read(
    tmp_path_factory: pytest.TempPathFactory, where: int, change: int
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    path = folder / "run.mcap"
    recorded(path, *(received("robot/state", STATE, n) for n in range(1, 6)))
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    ends = [c.chunk_start_offset + c.chunk_length for c in summary.chunk_indexes]
    data = bytearray(path.read_bytes())
    where %= len(data)
    data[where] ^= change
    path.write_bytes(data)
    warnings: list[str] = []
    try:
        found = [row.t for row in rows(path, warnings.append)]
    except RecordingError:
        assert where < len(MAGIC)
        return
    assert found[: (before := sum(end <= where for end in ends))] == [1, 2, 3, 4, 5][:before]
    assert found == [1, 2, 3, 4, 5] or "mcap recover" in warnings[0]


def test_a_file_larger_than_the_memory_is_read(path: Path) -> None:
    recording = recorded(path, *(received("robot/state", STATE, n) for n in range(3)))
    with recording.path.open("r+b") as file:
        file.truncate(MEMORY)  # a hole, and no end

    def limit_memory() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))

    done = call("export", str(path), "--to", "csv", preexec_fn=limit_memory)
    assert done.returncode == 0, done.stderr
    assert "3 messages" in done.stdout


@pytest.mark.parametrize("to", ["csv", "ros2"])
def test_an_export_of_a_recording_that_was_cut_does_not_end_as_complete(
    to: str, tmp_path: Path
) -> None:
    if to == "ros2":
        pytest.importorskip("armadico.bridge.ros2")
    path, cut = tmp_path / "run.mcap", tmp_path / "cut.mcap"
    recorded(path, *(received("robot/state", STATE, n) for n in range(1, 10)))
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert call("export", str(path), "--to", to).returncode == 0
    done = call("export", str(cut), "--to", to)
    assert done.returncode == options.UNKNOWN, done.stderr
    assert "how many are missing is not known" in done.stderr
    made = tmp_path / ("cut-csv/robot1_robot_state.csv" if to == "csv" else "cut-ros2.mcap")
    assert made.stat().st_size, "what could be read is kept"


def test_a_damaged_recording_tells_how_many_messages_are_missing(tmp_path: Path) -> None:
    path, warnings = tmp_path / "run.mcap", list[str]()
    recorded(path, *(received("robot/state", STATE, n) for n in range(1, 10)))
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    data = bytearray(path.read_bytes())
    third = summary.chunk_indexes[2]
    data[third.chunk_start_offset + third.chunk_length - 1] ^= 255
    path.write_bytes(data)
    assert len(list(rows(path, warnings.append))) == 2
    assert "2 messages could be read, up to 0.0 s, 7 are missing" in warnings[0]


def test_tables_are_not_written_beside_those_of_another_recording(path: Path) -> None:
    """Tables of topics that the new one lacks would stay, and be taken for its own."""
    recorded(path, received("robot/state", STATE, 1))
    assert call("export", str(path), "--to", "csv").returncode == 0
    again = call("export", str(path), "--to", "csv")
    assert again.returncode == 1
    assert "run-csv holds tables already; name another folder with --out" in again.stderr


def test_an_export_names_the_files_in_which_the_recording_continues(
    tmp_path: Path, path: Path
) -> None:
    recorded(path, received("robot/state", STATE, 1))
    for number in (1, 2):
        (tmp_path / f"run-00{number}.mcap").write_bytes(path.read_bytes())
    first = call("export", str(path), "--to", "csv")
    assert first.returncode == 0
    assert "only run.mcap was exported" in first.stderr
    assert "continues in run-001.mcap to run-002.mcap" in first.stderr
    last = call("export", str(tmp_path / "run-002.mcap"), "--to", "csv")
    assert "continues" not in last.stderr


def test_tables_of_a_world_are_refused_as_they_have_no_walls(tmp_path: Path, path: Path) -> None:
    recorded(path, received("robot/state", STATE, 1))
    refused = call("export", str(path), "--to", "csv", "--world", "sc1")
    assert refused.returncode == options.USAGE
    assert "--world: tables have no walls" in refused.stderr
    assert not (tmp_path / "run-csv").exists()


def test_tables_have_a_file_per_topic_and_a_column_per_field(tmp_path: Path, path: Path) -> None:
    released = m.Claim("wheels", BALLOT, CYCLE, None)
    recorded(
        path,
        received("resource/wheels/utility", CLAIM, SECOND),
        received("encoder/pose", POSE, SECOND + SECOND // 2),
        received("resource/wheels/utility", released, 2 * SECOND),
    )
    with Tables(tmp_path / "out") as tables:
        for row in read(path):
            tables.write(row)
    with (tmp_path / "out" / "robot1_resource_wheels_utility.csv").open() as stream:
        claims = list(csv.DictReader(stream))
    assert [row["t"] for row in claims] == ["0.000000", "1.000000"]
    assert [row["utility"] for row in claims] == ["0.6", ""]
    assert claims[0]["ballot.instance"] == "goto-1"
    assert json.loads(claims[0]["commanded"]) == [0.2, 0.0]
    with (tmp_path / "out" / "robot1_encoder_pose.csv").open() as stream:
        assert [row["x"] for row in csv.DictReader(stream)] == ["1.5"]


def test_tables_that_are_interrupted_leave_no_folder(tmp_path: Path, path: Path) -> None:
    recorded(path, received("encoder/pose", POSE, SECOND))
    with suppress(KeyboardInterrupt), Tables(tmp_path / "out") as tables:
        for row in read(path):
            tables.write(row)
        raise KeyboardInterrupt
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


def test_a_recording_is_drawn_like_the_dashboard(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    path, out = tmp_path / "run.mcap", tmp_path / "run.rrd"
    recorded(
        path,
        Presence("robot1", "goto", "goto-1", True, 1),
        received("robot/state", STATE, 2),
        received("encoder/pose", POSE, 3),
        received("agent/goto/goto-1/bids", m.BidHistory("goto-1", (bid(1),)), 4, on_query=True),
        Received("robot1", "encoder/pose", b"broken", 5),
    )
    warnings: list[str] = []
    assert to_rrd(path, out, None, None, {}, warnings.append) == 3
    assert not warnings
    assert out.stat().st_size > 1000


def test_of_several_robots_one_is_drawn(tmp_path: Path, path: Path) -> None:
    pytest.importorskip("rerun")
    recorded(
        path, received("robot/state", STATE), Received("robot2", "robot/state", m.encode(STATE), 1)
    )
    with pytest.raises(RecordingError, match="robot1, robot2"):
        to_rrd(path, tmp_path / "run.rrd", None, None, {}, lambda _: None)
    assert to_rrd(path, tmp_path / "run.rrd", "robot2", None, {}, lambda _: None) == 1


# Journals -----------------------------------------------------------------------------------------


def piece(number: int, instance: str = "goto-1") -> m.JournalPiece:
    return m.JournalPiece(instance, number, b"")


def test_missing_pieces_are_queried_until_they_arrive() -> None:
    gaps = Gaps()
    assert all(gaps.add("robot1", piece(n)) for n in (0, 1, 4))
    assert gaps.lost == 2
    assert gaps.due() == gaps.due() == [("robot1", "goto-1", 2), ("robot1", "goto-1", 3)]
    assert gaps.add("robot1", piece(2))
    assert not gaps.add("robot1", piece(2))  # a duplicate
    assert not gaps.add("robot1", piece(1))
    assert gaps.due() == [("robot1", "goto-1", 3)]


class Lossy:
    """A watcher that does not receive piece 1 until it is queried."""

    def __init__(self) -> None:
        self._waiting = [piece(0), piece(2)]

    def get(self, _: float) -> Received | None:
        return received("journal/goto-1", self._waiting.pop(0)) if self._waiting else None

    def subscribe(self) -> None: ...

    watch_alive = subscribe

    def query_piece(self, _n: str, _i: str, number: int, _t: float) -> None:
        self._waiting.append(piece(number))


def test_missing_pieces_are_queried_before_the_end(tmp_path: Path) -> None:
    watcher: Any = Lossy()
    recording = Recording(tmp_path / "run.mcap")
    record(watcher, recording, lambda _: None, over=lambda: recording.gaps.lost > 0)
    recording.close()
    assert not recording.gaps.lost
    assert len(read(recording.path)) == 3


def test_the_first_piece_of_an_agent_is_expected_if_other_agents_keep_journals() -> None:
    gaps = Gaps()
    gaps.expect("robot1", "avoid-1")
    assert not gaps.lost  # no agent keeps a journal
    gaps.add("robot1", piece(0))
    for namespace, instance in (("robot1", "goto-1"), ("robot1", "avoid-1"), ("robot2", "goto-2")):
        gaps.expect(namespace, instance)
    assert gaps.due() == [("robot1", "avoid-1", 0)]
    assert gaps.add("robot1", piece(0, "avoid-1"))
    assert not gaps.lost


def test_the_number_of_queries_per_piece_is_bounded() -> None:
    gaps = Gaps()
    gaps.add("robot1", piece(3, "avoid-1"))
    gaps.add("robot2", piece(0))
    queries = [gaps.due() for _ in range(TRIES + 1)]
    assert queries[0] == [("robot1", "avoid-1", n) for n in range(3)]
    assert queries[-1] == []
    assert gaps.lost == 3


def test_a_recording_that_cannot_be_made_ends_the_run_before_it_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(options, "find_spec", lambda _: None)
    words = ["run", "sc1", "--virtual", "--record", str(tmp_path / "run.mcap")]
    assert cli.main(words) == options.FAILED
    told = capsys.readouterr()
    assert "pip install 'armadico[record]'" in told.err
    assert "reached" not in told.out


@pytest.mark.parametrize(("kept", "lost", "code"), [(9, 0, 0), (9, 3, 3), (0, 0, 3)])
def test_a_recording_that_lost_messages_is_not_whole(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, kept: int, lost: int, code: int
) -> None:
    monkeypatch.setattr(options.Meshes, "join_each", lambda _: [VirtualSession(VirtualMesh(1))])
    monkeypatch.setattr(VirtualSession, "wait_joined", lambda *_: True)
    monkeypatch.setattr(command, "_record", lambda *_: (kept, lost))
    assert cli.main(["record", str(tmp_path / "run.mcap")]) == code
