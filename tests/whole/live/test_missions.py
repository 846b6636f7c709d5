"""A society that `armadico up MISSION` keeps up, missions ordered of it, and what was recorded."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from signal import SIGINT, SIGKILL

import pytest

pytest.importorskip("mcap")

from armadico.agents.missions.messages import Alarm, Board, BoardMission, MissionEnd, Photo
from armadico.core.messages import Message
from armadico.watch.recordings import rows
from tests.programs import Start, call, starter
from tests.robot.society import SOON, Observer

pytestmark = pytest.mark.live

SCENARIO = """\
world = "surveillance"
start = [1.5, 2.0, 90.0]
sensors = "ideal"

[[alarms]]
room = "R2"
during = "wait"
within = "R2"
"""

LOOK = """\
scenario = "here.toml"
energy = "risk"
on_alarm = "check-alarm"
steps = [
  { do = "take-photo" },
  { do = "wait", seconds = 6 },
  { do = "take-photo" },
]
"""

URGENT = """\
scenario = "here.toml"
priority = 0.9
energy = "risk"
steps = [{ do = "wait", seconds = SECONDS }]
"""


@pytest.fixture
def programs(apart: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Start]:
    """Start `armadico` with these words; killed with all its children if it is left."""
    monkeypatch.chdir(tmp_path)  # pictures go there
    with starter() as start:
        yield start


@pytest.mark.long
def test_missions_of_a_society_that_is_up_from_the_order_to_the_recording(
    programs: Start, observer: Observer, tmp_path: Path
) -> None:
    files = {"here": SCENARIO, "look": LOOK}
    files |= {"short": URGENT.replace("SECONDS", "1"), "long": URGENT.replace("SECONDS", "900")}
    for name, text in files.items():
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")

    def board() -> dict[str, BoardMission]:
        newest = observer.client.latest(Board)
        return {} if newest is None else {each.name: each for each in newest.missions}

    def is_so(name: str, state: MissionEnd) -> None:
        observer.until(lambda: name in board() and board()[name].state is state, f"{name}: {state}")

    observer.client.listen(Board)
    up = programs("up", "look.toml")
    assert up.stdout is not None
    assert "is up after" in up.stdout.readline()
    recorder = programs("record", "all.mcap", "--quiet")
    look = programs("mission", "run", "look.toml", "--attach", "--json")
    is_so("look", MissionEnd.ACTIVE)
    observer.until(lambda: "alarm" in str(board()["look"].course), "the alarm is planned for")
    told = json.loads(call("mission", "alarms", "--json").stdout)
    assert [row["room"] for row in told] == ["R2"]

    done = call("mission", "run", "short.toml", "--attach", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["done"] is True

    long = programs("mission", "run", "long.toml", "--attach", "--json")
    is_so("long", MissionEnd.ACTIVE)
    assert board()["look"].state is MissionEnd.SUSPENDED
    (planning,) = [i for name, i in observer.client.alive if name == "mission-planning"]
    os.kill(observer.pid_of("mission-planning", planning), SIGKILL)
    before = ("mission-planning", planning)
    observer.until(lambda: before not in observer.client.alive, "it is gone")
    observer.until(lambda: "mission-planning" in observer.names, "it is back")
    status = json.loads(call("mission", "status", "--json").stdout)
    assert {row["name"]: row["state"] for row in status} == {
        "look": "suspended",
        "short": "done",
        "long": "active",
    }
    cancelled = call("mission", "cancel", "long")
    assert (cancelled.returncode, cancelled.stdout) == (0, "cancelled\n"), cancelled.stderr
    out, errors = long.communicate(timeout=SOON)
    assert long.returncode == 1, errors
    assert "cancelled" in json.loads(out)["why"]

    out, errors = look.communicate(timeout=2 * SOON)
    assert look.returncode == 0, errors
    steps = [task["step"] for task in json.loads(out)["tasks"]]
    assert steps == ["take-photo", "move(R2)", "check-alarm(R2)", "wait(6.0)", "take-photo"]
    told = call("mission", "log", "look").stdout
    assert told.count("take-photo done: photo in R2") == 2

    recorder.send_signal(SIGINT)
    recorder.communicate(timeout=SOON)
    down = call("down")
    assert down.returncode == 0, down.stderr
    assert up.wait(SOON) == 0

    kept: list[Message] = [row.message for row in rows(tmp_path / "all.mcap", pytest.fail)]
    last = next(message for message in reversed(kept) if isinstance(message, Board))
    assert {each.name: each.state for each in last.missions} == {
        "look": MissionEnd.DONE,
        "short": MissionEnd.DONE,
        "long": MissionEnd.CANCELLED,
    }
    assert [message.room for message in kept if isinstance(message, Photo)] == ["R2"] * 2
    assert {message.room for message in kept if isinstance(message, Alarm) and message.on} == {"R2"}
