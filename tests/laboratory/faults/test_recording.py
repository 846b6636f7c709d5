"""The checker of promises on recordings: a sound one, and one in which a ballot goes down."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from msgspec.structs import replace

from armadico.cli import main
from armadico.cli.options import UNKNOWN, USAGE
from armadico.core.exchange import fuzzy_window
from armadico.core.messages import (
    Ack,
    Ballot,
    BidHistory,
    BidRecord,
    Card,
    Claim,
    Cycle,
    Description,
    Message,
    RobotState,
    encode,
)
from armadico.core.resources import WHEELS
from armadico.mobile.messages import MissionState, MissionStatus, Pose, Truth
from armadico.observe.watching import Presence, Received
from armadico.watch.recorder import Recording
from armadico.watch.recordings import RecordingError, rows
from armadico_tools.faults.checker import Checker
from armadico_tools.faults.fault_types import Promise
from armadico_tools.faults.observations import Bids, Left, Published
from armadico_tools.faults.recording import check, observations

SECOND = 1_000_000_000
GOTO = "goto-0000000000000001"


def state(number: int) -> RobotState:
    return RobotState(Cycle(1, number), 0, 0, 0, 0.3, 0, 12, True, False)


def ack(number: int, term: int) -> Ack:
    by = Ballot(term, 0.6, False, GOTO)
    return Ack("wheels", Cycle(1, number), by, by, Cycle(1, number - 1), 0.6)


def kept(path: Path, terms: list[int]) -> Path:
    """A recording of cycles in which ballots of these terms are obeyed."""
    recording = Recording(path)

    def record_message(at: float, key: str, message: Message, *, queried: bool = False) -> None:
        recording.add(Received("robot1", key, encode(message), int(at * SECOND), queried))

    recording.add(Presence("robot1", "goto", GOTO, True, SECOND))
    for number, term in enumerate(terms, 10):
        record_message(1 + number / 10, "robot/state", state(number))
        record_message(1 + number / 10, "resource/wheels/ack", ack(number, term))
    record = BidRecord(Cycle(1, 8 + len(terms)), "wheels", 0.6, False, (0.3, 0.0), "leg 0")
    end = 2 + len(terms) / 10
    record_message(end, f"agent/goto/{GOTO}/bids", BidHistory(GOTO, (record,)), queried=True)
    record_message(end, "encoder/pose", Pose(Cycle(1, 9), 0, 0, 0))
    recording.add(Presence("robot1", "goto", GOTO, False, int(end * SECOND)))
    recording.close()
    return path


def test_a_sound_recording_breaks_no_promise(tmp_path: Path) -> None:
    path = kept(tmp_path / "sound.mcap", [1, 1, 2, 2])
    assert not check(path, None, pytest.fail).violations


def test_a_ballot_that_goes_down_is_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = kept(tmp_path / "broken.mcap", [2, 2, 1])
    promises = {violation.promise for violation in check(path, "robot1", pytest.fail).violations}
    assert promises == {Promise.ONE_DRIVER}
    assert main(["faults", "--recording", str(path)]) == 1
    assert Promise.ONE_DRIVER in capsys.readouterr().out
    assert main(["faults", "--recording", str(path), "--namespace", "robot2"]) == USAGE
    assert "no messages of 'robot2'; --namespace: robot1" in capsys.readouterr().err


def test_everything_that_is_recorded_is_shown_in_order(tmp_path: Path) -> None:
    path = kept(tmp_path / "sound.mcap", [1, 1])
    seen = [*observations(rows(path, pytest.fail))]
    assert [type(each) for each in seen] == [
        Published,
        Published,
        Published,
        Published,
        Bids,
        Published,
        Left,
    ]
    (bids,) = [each for each in seen if isinstance(each, Bids)]
    assert (bids.instance, bids.age) == (GOTO, pytest.approx(0.1))
    assert [each.at for each in seen] == sorted(each.at for each in seen)


@pytest.mark.parametrize("first", ["winner", "loser"])
@pytest.mark.parametrize("blended", [True, False])
def test_a_takeover_may_be_recorded_before_the_last_claim(
    tmp_path: Path, first: str, blended: bool
) -> None:
    """Both speak at once; the winner had received what the loser wanted in that very cycle."""
    recording = Recording(path := tmp_path / "handed.mcap")

    def record_message(at: float, key: str, message: Message) -> None:
        recording.add(Received("robot1", key, encode(message), round(at * SECOND)))

    def claim(number: int, ballot: Ballot, wanted: float, commanded: float) -> Claim:
        cycle, least = Cycle(1, number), ballot.utility
        return Claim("wheels", ballot, cycle, least, wanted=(wanted, 0.0), commanded=(commanded, 0))

    loser, winner = Ballot(1, 0.6, False, GOTO), Ballot(2, 0.9, False, "gothrough-2")
    last, step, wants = 40, 0.02, 0.1
    for number in range(10, last + 1):
        at, speed = number / 10, step * (number - 10)
        record_message(at, "robot/state", replace(state(number), v=speed - step))
        record_message(
            at, "resource/wheels/ack", replace(ack(number, 1), measured=(speed - step, 0.0))
        )
        spoken = [claim(number, loser, speed, speed)]
        if number == last:
            window = fuzzy_window((speed - wants) / WHEELS.scale[0])
            share = 0.9 / (0.9 + 0.6 * (window - 1.0)) if blended else 1.0
            begins = speed + share * (wants - speed)
            spoken.insert(0 if first == "winner" else 1, claim(number, winner, wants, begins))
        for later, each in enumerate(spoken):
            record_message(at + 0.01 + later / 1000, "resource/wheels/utility", each)
    recording.close()
    broken = {violation.promise for violation in check(path, None, pytest.fail).violations}
    assert broken == (set() if blended else {Promise.SMOOTH})


@pytest.mark.parametrize("keep", ["robot/state", "resource/wheels/ack", "sim/truth"])
def test_what_a_recording_does_not_hold_is_unknown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], keep: str
) -> None:
    messages = {
        "robot/state": state(1),
        "resource/wheels/ack": ack(1, 1),
        "sim/truth": Truth(0, 0, 0, 0, 0, 0, 0, None, "sim"),
    }
    recording = Recording(path := tmp_path / "blind.mcap")
    recording.add(Received("robot1", keep, encode(messages[keep]), SECOND))
    recording.close()
    assert main(["faults", "--recording", str(path)]) == UNKNOWN
    said = capsys.readouterr().out
    for key, what in (("robot/state", "stops and speeds"), ("resource/wheels/ack", "which agent")):
        assert (f"{what}" in said) is (key != keep)


def test_what_a_recording_did_not_hold_for_a_while_is_unknown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def recorded(without: frozenset[int]) -> Path:
        recording = Recording(path := tmp_path / f"{len(without)}.mcap")
        for number in range(100):
            messages: dict[str, Message] = {
                "robot/state": state(number + 1),
                "resource/wheels/ack": ack(number + 1, 1),
            }
            if number not in without:
                messages["sim/truth"] = Truth(number / 10, 0.03 * number, 0, 0, 0.3, 0, 0, 1, "")
            for key, message in messages.items():
                at = SECOND + number * SECOND // 10
                recording.add(Received("robot1", key, encode(message), at))
        recording.close()
        return path

    for without, expected in ((frozenset[int](), False), (frozenset(range(30, 70)), True)):
        main(["faults", "--recording", str(recorded(without))])
        said = capsys.readouterr().out
        assert ("no Truth received from 2.9 to 7.0 s" in said) is expected, said


@pytest.mark.parametrize(
    ("bids", "leaves", "gap"),
    [
        (range(100), False, ""),
        ([*range(30), *range(70, 100)], False, "between cycles 29 and 70"),
        (range(60), False, "between cycles 59 and 99"),
        (range(60), True, ""),
        (range(0), False, "between cycles 0 and 99"),
        (range(0), True, ""),
    ],
)
def test_whether_an_agent_bid_is_unknown_where_its_bids_were_not_recorded(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    bids: Sequence[int],
    leaves: bool,
    gap: str,
) -> None:
    recording = Recording(path := tmp_path / "bids.mcap")
    recording.add(Presence("robot1", "goto", GOTO, True, SECOND))
    card = Card("goto", GOTO, "lab1", 7, "1", 1, (), (), ("wheels",))
    recording.add(Received("robot1", f"agent/goto/{GOTO}/card", encode(card), SECOND, True))
    for number in range(100):
        at = SECOND + number * SECOND // 10
        recording.add(Received("robot1", "robot/state", encode(state(number)), at))
        record = BidRecord(Cycle(1, number), "wheels", None, False, (), "no goal")
        history = encode(BidHistory(GOTO, (record,)))
        if number in bids:
            recording.add(Received("robot1", f"agent/goto/{GOTO}/bids", history, at, True))
        elif leaves:
            recording.add(Presence("robot1", "goto", GOTO, False, at))
    recording.close()
    main(["faults", "--recording", str(path), "--json"])
    why = json.loads(capsys.readouterr().out)["judgement"]["reason"]
    assert (f"whether an agent bid is unknown: no bids of {GOTO} {gap}" in why) is bool(gap), why


def described(v_decel: float) -> Description:
    sizes, ramps = (0.3, 0.3, 0.2), (0.5, v_decel, 2.0, 2.0)
    return Description("other", 0.1, *sizes, 2.0, 4.0, *ramps, 0.3, 1.0)


def braking(path: Path, *about: Description | None) -> Path:
    """A recording of robots that brake by 2 m/s^2, and describe themselves."""
    recording = Recording(path)
    for number in range(10):
        v = max(1.0 - 0.2 * number, 0.0)
        messages = {
            "robot/state": state(number + 1),
            "sim/truth": Truth(number / 10, 0, 0, 0, v, 0, 0, 1, ""),
        }
        for robot, each in enumerate(about, 1):
            said = {"robot/description": each, **messages} if each else messages
            for key, message in said.items():
                at = SECOND + number * SECOND // 10
                recording.add(Received(f"robot{robot}", key, encode(message), at))
    recording.close()
    return path


def test_ramps_are_those_that_the_robot_describes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(path: Path) -> set[Promise]:
        return {each.promise for each in check(path, None, pytest.fail).violations}

    steep, flat = (braking(tmp_path / f"{v}.mcap", described(v)) for v in (2.0, 0.5))
    assert Promise.SMOOTH not in broken(steep)
    assert Promise.SMOOTH in broken(flat)
    unknown = braking(tmp_path / "unknown.mcap", None)
    assert Promise.SMOOTH not in broken(unknown), "of a robot that is not known"
    main(["faults", "--recording", str(unknown)])
    assert "ramps are unknown" in capsys.readouterr().out


def test_one_of_several_robots_must_be_named(tmp_path: Path) -> None:
    path = braking(tmp_path / "two.mcap", described(2.0), described(0.5))
    with pytest.raises(RecordingError, match="robot1, robot2"):
        check(path, None, pytest.fail)
    for robot, breaks in (("robot1", False), ("robot2", True)):
        found = {each.promise for each in check(path, robot, pytest.fail).violations}
        assert (Promise.SMOOTH in found) is breaks


def test_messages_that_could_not_be_decoded_are_why_it_is_unknown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = Recording(path := tmp_path / "spoilt.mcap")
    for data in (encode(state(1)), b"\xff", b"\xff"):
        recording.add(Received("robot1", "robot/state", data, SECOND))
    recording.close()
    assert main(["faults", "--recording", str(path)]) == UNKNOWN
    assert "2 messages that could not be decoded; " in capsys.readouterr().out


def test_what_the_auditor_could_not_judge_is_unknown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """There were paths and no map: none is known to lead through no wall."""
    path = tmp_path / "paths.mcap"
    recording = Recording(path)
    for number in range(10):
        for key, message in (
            ("robot/state", state(number + 1)),
            ("interface/mission", MissionStatus(1, MissionState.DRIVING, 0.0)),
        ):
            at = SECOND + number * SECOND // 10
            recording.add(Received("robot1", key, encode(message), at))
    recording.close()
    assert main(["faults", "--recording", str(path)]) == UNKNOWN
    assert f"{Promise.PATH}: not checked" in capsys.readouterr().out


def test_a_recording_of_another_protocol_is_unknown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Recording(path := tmp_path / "old.mcap", {"protocol": "0"}).close()
    assert main(["faults", "--recording", str(path)]) == UNKNOWN
    assert "protocol 0" in capsys.readouterr().out


def test_a_recording_that_was_cut_is_not_known_to_be_sound(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def cut(path: Path, namespace: str | None, warn: Callable[[str], None]) -> Checker:
        warn("it was cut short")
        return check(path, namespace, warn)

    monkeypatch.setattr("armadico_tools.faults.recording.check", cut)
    path = kept(tmp_path / "cut.mcap", [1, 1, 2, 2])
    assert main(["faults", "--recording", str(path), "--json"]) == UNKNOWN
    assert "cut short" in json.loads(capsys.readouterr().out)["judgement"]["reason"]
