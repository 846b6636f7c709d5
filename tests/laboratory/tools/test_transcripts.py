"""The transcripts, vectors and schema, by which an agent in any language is checked."""

from __future__ import annotations

import json
import random
import re
from pathlib import Path
from typing import Any

import cbor2
import msgspec
import pytest

from armadico.cli.options import UsageError
from armadico.core.coordination import Contender, plausible
from armadico.core.cycles import CycleClock
from armadico.core.driver import misaddressed
from armadico.core.exchange import EXCHANGES
from armadico.core.messages import Ack, Ballot, Cycle, MessageError, decode, encode
from armadico.core.resources import WHEELS
from armadico_tools.transcripts import __main__ as tool
from armadico_tools.transcripts.__main__ import DOCS, FOLDER, VECTORS, payload_of
from armadico_tools.transcripts.replay import (
    KINDS,
    Line,
    difference_of,
    fields_of,
    inputs,
    outputs,
    read,
)

SCENES = {
    path.stem: read(path.read_text(encoding="utf-8"))
    for path in sorted(FOLDER.glob("*.jsonl"))
    if path.stem != "vectors"
}


@pytest.mark.parametrize("path", tool.files(), ids=lambda path: path.name)
def test_what_is_written_from_the_code_is_fresh(path: Path) -> None:
    fresh = path.read_text(encoding="utf-8") == tool.files()[path]
    assert fresh, "python -m armadico_tools.transcripts writes it again"


# An agent is compared -----------------------------------------------------------------------------


def published(name: str, label: str) -> list[Line]:
    """What a program would write that publishes what the file has."""
    lines = outputs(SCENES[name], label)
    return [{k: x[k] for k in ("t", "key", "cbor")} for x in lines if x["what"] == "publishes"]


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
    assert difference_of(SCENES["take-over"], "a", short) == ""


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
def test_every_difference_is_reported(change: Any, why: str) -> None:
    lines = change(published("hand-over", "a"))
    assert why in difference_of(SCENES["hand-over"], "a", lines)


def test_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = str(FOLDER / "take-over.jsonl")
    assert tool.main(["inputs", file, "--agent", "b"]) == 0
    given = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert given == inputs(SCENES["take-over"], "b")
    mine = tmp_path / "mine.jsonl"
    mine.write_text("".join(json.dumps(x) + "\n" for x in published("take-over", "b")[:-1]))
    assert tool.main(["replay", file, "--agent", "b", "--said", str(mine)]) == 1
    assert "it is not published" in capsys.readouterr().out
    with pytest.raises(UsageError, match="there are: robot, a, b"):
        tool.main(["inputs", file, "--agent", "nobody"])


# Payloads one by one ------------------------------------------------------------------------------


LINES = [json.loads(line) for line in VECTORS.read_text(encoding="utf-8").splitlines()]


@pytest.mark.parametrize("line", LINES, ids=lambda line: line["what"])
def test_payloads_are_accepted_or_refused_as_in_the_file(line: Line) -> None:
    payload, kind = payload_of(line), KINDS[line["type"]]
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


def test_an_ack_with_a_ballot_too_far_ahead_is_otherwise_accepted() -> None:
    clock = CycleClock()
    clock.advance(Cycle(7, 42), 0.0)
    contender = Contender(WHEELS, "a-1", clock, EXCHANGES["abrupt"], random.Random(1))
    line = next(x for x in LINES if x["type"] == "Ack" and "largest_known_term" in x)
    ack = decode(payload_of(line), Ack)
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
    text = (DOCS / "protocol.cddl").read_text(encoding="utf-8")
    rules = set(re.findall(r"^(\w+) = \[", text, re.MULTILINE))
    assert rules == set(KINDS)
    fields = set(re.findall(r"^ +(?:\? )?([\w-]+):", text, re.MULTILINE))
    assert not (rules | fields) & PRELUDE
    assert {"number_", "text_", "obeyed-cycle"} <= fields
