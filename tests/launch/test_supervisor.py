"""What of its processes' logs `up` passes on, how long a log may grow, and who is asked for a card.

Agents are fakes: nothing is started, and nobody waits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from armadico.core.messages import PROTOCOL, Card, encode
from armadico.core.restart_policy import IN_THE_WAY_S, MISUSED, NEWCOMER_S
from armadico.launch.society import Member
from armadico.launch.supervisor import CARD_S, GaveUpError, Plan, Tail, Upkeep
from tests.mesh.fakes import FakeMesh

STAMP = "12:00:00.123 goto"


@pytest.fixture
def log(tmp_path: Path) -> Path:
    file = tmp_path / "goto.log"
    file.touch()
    return file


def write(log: Path, *lines: str, end: str = "\n") -> None:
    with log.open("a") as file:
        file.write("\n".join(lines) + end)


def test_faults_are_passed_on_with_who_says_them_and_the_rest_is_not(log: Path) -> None:
    tail = Tail("goto-2", log)
    assert tail.loud() == []
    write(log, f"{STAMP} INFO began", f"{STAMP} WARNING slow", f"{STAMP} ERROR no way")
    assert tail.loud() == ["goto-2: WARNING slow", "goto-2: ERROR no way"]
    assert tail.loud() == []


def test_what_belongs_to_a_line_goes_with_it(log: Path) -> None:
    tail = Tail("goto", log)
    write(log, f"{STAMP} ERROR it failed", "Traceback (most recent call last):", "  here")
    write(log, f"{STAMP} INFO a list:", "  of things", end="\n")
    assert tail.loud() == [
        "goto: ERROR it failed",
        "goto: Traceback (most recent call last):",
        "goto:   here",
    ]


def test_what_is_said_before_there_is_a_log_is_passed_on(log: Path) -> None:
    tail = Tail("goto", log)
    write(log, "armadico-agent: --set v_max=fast: expected a number")
    assert tail.loud() == ["goto: armadico-agent: --set v_max=fast: expected a number"]


def test_half_a_line_waits_for_the_rest(log: Path) -> None:
    tail = Tail("goto", log)
    write(log, f"{STAMP} WARN", end="")
    assert tail.loud() == []
    write(log, "ING slow")
    assert tail.loud() == ["goto: WARNING slow"]


def test_a_long_log_is_begun_anew_while_it_is_written_to(
    log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armadico.launch.supervisor.LOG_BYTES", 100)
    tail = Tail("goto", log)
    with log.open("ab", buffering=0) as agent:  # as a process has it
        agent.write(f"{STAMP} INFO {'long ' * 30}\n".encode())
        tail.loud()
        tail.turn()
        assert log.stat().st_size == 0
        assert log.with_suffix(".log.1").read_text().startswith(STAMP)
        agent.write(f"{STAMP} ERROR short\n".encode())
        assert tail.loud() == ["goto: ERROR short"]
        tail.turn()
    assert log.stat().st_size == len(f"{STAMP} ERROR short\n")


# Cards --------------------------------------------------------------------------------------------


class Share:
    """A goto and an avoid that are up here, on a mesh that the test plays."""

    def __init__(self) -> None:
        self.mesh = FakeMesh()
        plan = Plan("lab1", "ns", (Member("goto"), Member("avoid")))
        self.said: list[str] = []
        self.upkeep = Upkeep(plan, cast("Any", self.mesh), self.said.append)
        for pid, label in enumerate(("goto", "avoid")):
            process = SimpleNamespace(popen=SimpleNamespace(pid=pid), ended=lambda: False)
            self.upkeep.processes[label] = cast("Any", process)
            self.upkeep._waiting[label] = 0.0

    def appear(self, *instances: str) -> None:
        for instance in instances:
            self.mesh.changed(instance.rpartition("-")[0], instance, True)
        self.settle()

    def settle(self) -> None:
        """Take what has come."""
        self.upkeep._client.wait_for(lambda: not self.upkeep._client._inbox._mailbox, 60.0)

    def greet(self, monkeypatch: pytest.MonkeyPatch) -> list[str]:
        """Who is asked for a card; it may not wait for anybody."""
        before = len(self.mesh.asked_keys)
        with monkeypatch.context() as patched:
            patched.setattr(self.upkeep._client, "wait_for", self._waits)
            self.upkeep._greet()
        return [key.split("/")[2] for key in self.mesh.asked_keys[before:]]

    @staticmethod
    def _waits(condition: Callable[[], Any], timeout: float) -> Any:
        raise AssertionError(f"it waits for up to {timeout} s, and looks after nobody meanwhile")

    def answer(self, instance: str, pid: int, host: str = "lab1") -> None:
        """An agent's card comes."""
        name = instance.rpartition("-")[0]
        key = f"agent/{name}/{instance}/card"
        card = Card(name, instance, host, pid, "1", PROTOCOL, (), (), ())
        each, _ = self.mesh.asked[self.mesh.asked_keys.index(key)]
        each(key, encode(card))
        self.settle()


@pytest.fixture
def share() -> Iterator[Share]:
    share = Share()
    yield share
    share.upkeep.logs.rmdir()


def test_one_that_never_answers_delays_nobody(
    share: Share, monkeypatch: pytest.MonkeyPatch
) -> None:
    share.appear("avoid-dead", "avoid-2", "goto-1")
    assert share.greet(monkeypatch) == ["avoid-2", "avoid-dead", "goto-1"], "all at once"
    assert share.greet(monkeypatch) == [], "and each once"
    share.answer("goto-1", 0)
    share.greet(monkeypatch)
    assert list(share.upkeep._waiting) == ["avoid"]
    share.answer("avoid-2", 1)
    share.greet(monkeypatch)
    assert not share.upkeep._waiting, "everybody of this share is up"


def test_who_did_not_answer_in_time_is_asked_again(
    share: Share, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 100.0
    monkeypatch.setattr("armadico.launch.supervisor.time", SimpleNamespace(monotonic=lambda: now))
    share.appear("goto-1")
    assert share.greet(monkeypatch) == ["goto-1"]
    now += CARD_S - 0.01
    assert share.greet(monkeypatch) == []
    now += 0.02
    assert share.greet(monkeypatch) == ["goto-1"], "its time is over, whatever the mesh says"
    _, over = share.mesh.asked[-1]
    over()
    share.settle()
    assert share.greet(monkeypatch) == ["goto-1"], "nobody was there to answer"


def test_the_card_of_another_host_is_not_ones_own(
    share: Share, monkeypatch: pytest.MonkeyPatch
) -> None:
    share.appear("goto-1")
    share.greet(monkeypatch)
    share.answer("goto-1", 0, host="lab2")
    assert share.greet(monkeypatch) == []
    assert "goto" in share.upkeep._waiting


def test_whom_somebody_gets_in_the_way_of_is_tried_again_and_the_others_go_on(
    share: Share, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 100.0
    monkeypatch.setattr("armadico.launch.supervisor.time", SimpleNamespace(monotonic=lambda: now))
    share.appear("avoid-2", "goto-1")
    share.greet(monkeypatch)
    share.answer("goto-1", 0)
    share.answer("avoid-2", 1)
    share.greet(monkeypatch)
    now += NEWCOMER_S
    left = SimpleNamespace(popen=SimpleNamespace(pid=0, returncode=MISUSED), ended=lambda: True)
    share.upkeep.processes["goto"] = cast("Any", left)
    share.upkeep._mourn()
    assert [text.partition(";")[0] for text in share.said] == ["goto left: somebody is in its way"]
    assert list(share.upkeep.processes) == ["avoid"]
    assert share.upkeep.supervision.due(now + IN_THE_WAY_S[0]) == ["goto"]


def test_who_could_not_begin_at_all_ends_the_share(share: Share) -> None:
    left = SimpleNamespace(
        popen=SimpleNamespace(pid=0, returncode=MISUSED),
        ended=lambda: True,
        last_words=lambda: "another goto agent is alive already",
    )
    share.upkeep.processes["goto"] = cast("Any", left)
    with pytest.raises(GaveUpError, match="another goto agent is alive already"):
        share.upkeep._mourn()
