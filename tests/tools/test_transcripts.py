"""The transcripts are what our agents say, and enough to check somebody else's agent by."""

from __future__ import annotations

import json
import random
import re
from functools import cache
from pathlib import Path
from typing import Any

import cbor2
import msgspec
import pytest

from armadico.core.coordination import Contender, plausible
from armadico.core.cycles import CycleClock
from armadico.core.driver import misaddressed
from armadico.core.exchange import EXCHANGES
from armadico.core.messages import Ack, Ballot, Cycle, MessageError, decode, encode
from armadico.core.resources import WHEELS
from armadico_tools.docs import ROOT
from armadico_tools.transcripts import __main__ as tool
from armadico_tools.transcripts.replay import (
    LIFE,
    difference_of,
    first_difference,
    inputs,
    message_of,
    outputs,
    replayed,
)
from armadico_tools.transcripts.scenes import SCENES
from armadico_tools.transcripts.tape import KINDS, Line, Transcript, fields_of, read
from armadico_tools.transcripts.vectors import VECTORS, Vector

FOLDER = ROOT / tool.FOLDER
NAMES = [scene.name for scene in SCENES]
SIDES = [(scene.name, part.label) for scene in SCENES for part in scene.parts]


@cache
def transcript(name: str) -> Transcript:
    return read((FOLDER / f"{name}.jsonl").read_text(encoding="utf-8"))


def said(name: str, who: str, kind: str, since: float = 0.0) -> list[Line]:
    """What somebody publishes of a kind."""
    lines = transcript(name).lines
    return [x for x in lines if x["from"] == who and x.get("type") == kind and x["t"] >= since]


# The files are what the code says -----------------------------------------------------------------


def test_no_file_is_stale(capsys: pytest.CaptureFixture[str]) -> None:
    assert tool.main(["--check"]) == 0, "python -m armadico_tools.transcripts writes them again"
    assert not capsys.readouterr().out


def test_stale_files_are_told_and_written_and_what_nobody_writes_is_removed(tmp_path: Path) -> None:
    assert set(tool.write(tmp_path)) == set(tool.files())
    assert tool.write(tmp_path) == []
    (tmp_path / tool.FOLDER / "join.jsonl").write_text("{}\n")
    (tmp_path / tool.FOLDER / "old.jsonl").write_text("{}\n")
    assert set(tool.stale(tmp_path)) == {f"{tool.FOLDER}/join.jsonl", f"{tool.FOLDER}/old.jsonl"}
    tool.write(tmp_path)
    assert tool.stale(tmp_path) == {}
    assert not (tmp_path / tool.FOLDER / "old.jsonl").exists()


@pytest.mark.parametrize("name", NAMES)
def test_every_payload_is_its_fields_and_the_other_way_round(name: str) -> None:
    lines = [line for line in transcript(name).lines if "cbor" in line]
    assert len(lines) > 20
    for line in lines:
        message = message_of(line)
        assert fields_of(message) == line["fields"]
        assert encode(message).hex() == line["cbor"]
        again = msgspec.convert(arrays(line["fields"]), KINDS[line["type"]])
        assert encode(again).hex() == line["cbor"]


def arrays(fields: Any) -> Any:
    """Fields without their names, as they are on the wire."""
    return [arrays(x) for x in fields.values()] if isinstance(fields, dict) else fields


@pytest.mark.parametrize("name", NAMES)
def test_times_tell_the_order_in_which_one_process_receives(name: str) -> None:
    there = transcript(name)
    assert [x["t"] for x in there.lines] == sorted(x["t"] for x in there.lines)
    for part in there.agents:
        times = [x["t"] for x in inputs(there, part.label) if x["what"] not in LIFE]
        assert times == sorted(times)
        assert len(set(times)) == len(times)


# Our own agents are replayed ----------------------------------------------------------------------


@pytest.mark.parametrize(("name", "label"), SIDES)
def test_our_agent_says_what_the_file_has(name: str, label: str) -> None:
    there = transcript(name)
    assert outputs(there, label)
    assert first_difference(there, label) == ""


@pytest.mark.parametrize("kind", ["Ack", "RobotState", "Claim"])
def test_who_does_not_receive_something_says_something_else(kind: str) -> None:
    there = transcript("take-over")
    deaf = [
        {**x, "to": {**x["to"], "b": None}} if x.get("type") == kind and x["t"] > 1.0 else x
        for x in there.lines
    ]
    less = msgspec.structs.replace(there, lines=tuple(deaf))
    assert first_difference(less, "b")
    assert first_difference(less, "a") == ""


def test_another_bid_is_found_at_the_message_that_differs() -> None:
    there = transcript("take-over")
    text = there.text().replace('"utility": 0.9,', '"utility": 0.91,', 1)
    why = first_difference(read(text), "b")
    assert "another fields" in why
    assert why.startswith("1.60")


# Somebody else's agent is compared ----------------------------------------------------------------


@cache
def published(name: str, label: str) -> tuple[Line, ...]:
    """What a program would write that does as ours does."""
    lines = replayed(transcript(name), label)
    return tuple({k: x[k] for k in ("t", "key", "cbor")} for x in lines if x["what"] == "publishes")


@pytest.mark.parametrize(("name", "label"), SIDES)
def test_another_program_that_does_as_ours_is_content(name: str, label: str) -> None:
    assert difference_of(transcript(name), label, list(published(name, label))) == ""


def test_floats_may_be_as_short_as_they_like_and_the_draw_its_own() -> None:
    lines = published("take-over", "a")
    short = [
        {
            **x,
            "t": x["t"] + 0.009,
            "cbor": cbor2.dumps(cbor2.loads(bytes.fromhex(x["cbor"])), canonical=True).hex(),
        }
        for x in lines
    ]
    assert [x["cbor"] for x in short] != [x["cbor"] for x in lines]
    assert difference_of(transcript("take-over"), "a", short) == ""


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda lines: lines[:-1], "it is not published"),
        (lambda lines: [*lines, {**lines[-1], "t": 2.4}], "it is published, and should not be"),
        (lambda lines: [lines[1], lines[0], *lines[2:]], "another key"),
        (lambda lines: [{**lines[0], "t": 0.9}, *lines[1:]], "at another time"),
        (lambda lines: [{**lines[0], "cbor": "80"}, *lines[1:]], "not a Command"),
        (lambda lines: [{**lines[0], "key": "robot/cmd/x"}, *lines[1:]], "no agent publishes on"),
        (lambda lines: [lines[2], lines[1], *lines[2:]], "another cycle"),
    ],
)
def test_whatever_is_otherwise_is_told(change: Any, why: str) -> None:
    lines = change(list(published("hand-over", "a")))
    assert why in difference_of(transcript("hand-over"), "a", lines)


def test_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = str(FOLDER / "take-over.jsonl")
    assert tool.main(["replay", file, "--agent", "b"]) == 0
    assert "b publishes what take-over has" in capsys.readouterr().out
    assert tool.main(["inputs", file, "--agent", "b"]) == 0
    given = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert given == inputs(transcript("take-over"), "b")
    mine = tmp_path / "mine.jsonl"
    mine.write_text("".join(json.dumps(x) + "\n" for x in published("take-over", "b")[:-1]))
    assert tool.main(["replay", file, "--agent", "b", "--said", str(mine)]) == 1
    assert "it is not published" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        tool.main(["replay", file, "--agent", "nobody"])
    assert "there are: robot, a, b" in capsys.readouterr().err


# The scenes show what they say --------------------------------------------------------------------


def test_join_shows_three_cycles_of_listening() -> None:
    first = said("join", "a", "Command")[0]
    acks = [x for x in said("join", "robot", "Ack") if x["t"] < first["t"]]
    assert len(acks) == 4
    assert said("join", "b", "Claim") == []
    assert [x["what"] for x in outputs(transcript("join"), "b")][:2] == ["asks", "asks"]


def test_take_over_shows_the_better_bid_of_the_same_cycle() -> None:
    mine = said("take-over", "b", "Claim", 1.0)
    assert [x["fields"]["cycle"]["number"] for x in mine] == list(range(13, 21))
    back = said("take-over", "a", "Claim", 1.7)
    assert [x["fields"]["cycle"]["number"] for x in back] == [20]


@pytest.mark.parametrize(("lost", "kept"), [("Command", "Claim"), ("Claim", "Command")])
def test_either_release_will_do(lost: str, kept: str) -> None:
    name = f"hand-over-{lost.lower()}-lost"
    gone, there = said(name, "a", lost)[-1], said(name, "a", kept)[-1]
    assert set(gone["to"].values()) == {None}
    assert None not in there["to"].values()
    taken = said(name, "b", "Command", gone["t"])
    assert taken[0]["verdict"] == "obeyed"
    assert taken[0]["t"] - gone["t"] < 0.12


def test_who_hung_is_silent_and_its_old_command_refused() -> None:
    late = [x for x in said("hang", "a", "Command") if x["to"]["robot"] > x["t"] + 0.1]
    assert [x["verdict"] for x in late] == ["it answers a cycle that is too old, or not yet there"]
    assert not [x for x in said("hang", "a", "Claim", 1.58) if x["t"] < 2.25]
    assert said("hang", "b", "Command", 1.58)[0]["t"] < 1.76


def test_a_stop_with_a_smaller_counter_latches_and_a_late_one_does_not() -> None:
    stops = [x["fields"]["stop"] for x in said("stop", "robot", "RobotState")]
    seen = [s for s, before in zip(stops, [None, *stops], strict=False) if s != before]
    assert [(s["counter"], s["stopped"]) for s in seen] == [
        *((0, False), (5, True), (6, False), (7, True), (8, False))
    ]
    given = [x["fields"] for who in ("robot", "a", "b") for x in said("stop", who, "Stop", 2.9)]
    assert given
    assert all(fields["counter"] == 8 and not fields["stopped"] for fields in given)


def test_a_new_owner_is_given_the_stop_back_and_then_listened_to() -> None:
    states = said("restart", "robot2", "RobotState")
    assert states[0]["fields"]["stop"]["stopped"]
    (released,) = (x["t"] for x in said("restart", "client", "Stop", 2.0))
    assert not said("restart", "a", "Command", 1.4)[0]["t"] < released
    epochs = {x["fields"]["cycle"]["epoch"] for x in states}
    assert epochs != {x["fields"]["cycle"]["epoch"] for x in said("restart", "robot", "RobotState")}
    assert said("restart", "a", "Command", 1.7)[0]["verdict"] == "obeyed"


def test_a_tenure_outlives_its_owner_who_listens_for_three_cycles() -> None:
    driving = said("restart-driving", "a", "Command", 1.7)
    assert ["listens" in x["verdict"] for x in driving[:4]] == [True, True, True, False]
    assert driving[3]["verdict"] == "obeyed"
    assert (
        driving[0]["fields"]["ballot"]
        == said("restart-driving", "a", "Command")[0]["fields"]["ballot"]
    )


def test_the_lift_counts_its_own_cycles_and_has_limits() -> None:
    acks = [x["fields"] for x in said("second-resource", "hoist", "Ack")]
    assert [x["cycle"]["number"] for x in acks] == list(range(1, len(acks) + 1))
    refused = [x for x in said("second-resource", "a", "Command") if "limits" in x["verdict"]]
    assert len(refused) == 6
    assert acks[-1]["obeyed"]["instance"].startswith("b-")


# Payloads one by one ------------------------------------------------------------------------------


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector.what)
def test_a_payload_is_read_or_refused_as_the_file_says(vector: Vector) -> None:
    lines = (FOLDER / "vectors.jsonl").read_text(encoding="utf-8").splitlines()
    line = next(x for x in map(json.loads, lines) if x["what"] == vector.what)
    payload = bytes.fromhex(line["cbor"]) + bytes(line.get("zeros", 0))
    kind = KINDS[line["type"]]
    if line["accepted"]:
        assert fields_of(decode(payload, kind)) == line["fields"]
        assert encode(decode(payload, kind)).hex() == line["ours"]
        return
    if "key" not in line:
        with pytest.raises(MessageError):
            decode(payload, kind)
        return
    message = decode(payload, kind)
    known = line.get("largest_known_term")
    if known is None:
        assert misaddressed(line["key"], message)
        return
    assert misaddressed(line["key"], message) == ""
    ballot = message.largest if isinstance(message, Ack) else getattr(message, "ballot", None)
    assert isinstance(ballot, Ballot)
    assert not plausible(ballot, Ballot(known, 1.0, True, "z"))
    assert plausible(
        msgspec.structs.replace(ballot, term=ballot.term - 1), Ballot(known, 0, 0, "a")
    )


def test_an_ack_whose_ballot_is_too_far_ahead_is_otherwise_believed() -> None:
    clock = CycleClock()
    clock.advance(Cycle(7, 42), 0.0)
    contender = Contender(WHEELS, "a-1", clock, EXCHANGES["abrupt"], random.Random(1))
    vector = next(v for v in VECTORS if v.type is Ack and v.known is not None)
    ack = decode(vector.payload, Ack)
    contender.acked(ack, 0.0)
    assert contender.owned
    assert contender.largest is None


# The schema ---------------------------------------------------------------------------------------

PRELUDE = set(
    re.findall(
        r"\S+",
        "any uint nint int bstr bytes tstr text tdate time number biguint bignint bigint integer"
        " unsigned decfrac bigfloat eb64url eb64legacy eb16 encoded-cbor uri b64url b64legacy"
        " regexp mime-message cbor-any float16 float32 float64 float16-32 float32-64 float false"
        " true bool nil null undefined",
    )
)


def test_the_schema_has_every_message_and_no_name_of_the_prelude() -> None:
    text = (ROOT / "docs" / "protocol.cddl").read_text(encoding="utf-8")
    rules = set(re.findall(r"^(\w+) = \[", text, re.MULTILINE))
    assert rules == set(KINDS)
    fields = set(re.findall(r"^ +(?:\? )?([\w-]+):", text, re.MULTILINE))
    assert not (rules | fields) & PRELUDE
    assert {"number_", "text_", "obeyed-cycle"} <= fields


BEYOND = re.compile(
    r"NaN|nfinity|1e6|utility|129|control|terminal|line|tag|bignum|shared|indefinite|65,537|key|term"
    r"|a counter beyond"  # a stop has defaults for all: it is taken for something appended
)
"""What a schema cannot say."""


def test_the_schema_reads_what_must_be_read_and_refuses_other_shapes() -> None:
    zcbor = pytest.importorskip(
        "zcbor", reason="zcbor 0.9 needs a cbor2 below 6", exc_type=ImportError
    )
    text = (ROOT / "docs" / "protocol.cddl").read_text(encoding="utf-8")
    types = zcbor.DataTranslator.from_cddl(text, default_max_qty=100_000).my_types
    for vector in VECTORS:
        try:
            types[vector.type.__name__].validate_str(vector.payload)
            read_ = True
        except Exception:
            read_ = False
        if vector.accepted or not BEYOND.search(vector.what):
            assert read_ == vector.accepted, vector.what
