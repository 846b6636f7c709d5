"""Agents of another package take part as ours do: told what they declare, and no faster."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from msgspec.structs import replace

from armadico.config.hosts import Host
from armadico.config.scenarios import Scenario
from armadico.core.messages import Message
from armadico.launch.processes import agent_words, owns_wheels
from armadico.launch.society import Options, members, names, share
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import Truth

AGENTS = '''
"""Behaviours that were written elsewhere, and a robot agent."""
from typing import ClassVar
from armadico.bridge.robot import Robot
from armadico.core import agent
from armadico.core.agent import Agent
from armadico.core.exchange import Bid
from armadico.core.messages import Message
from armadico.mobile.messages import Pose
from armadico.core.resources import WHEELS


class Asked(agent.Parameters, frozen=True, kw_only=True):
    v_max: float = 0.7


class Racer(Agent):
    """Drives as fast as it is told to."""

    name = "racer"
    reacts_to = Pose
    needs: ClassVar[tuple[type[Message], ...]] = (Pose,)
    competes_for = (WHEELS,)
    parameters = Asked
    launched_with = ("v_max",)

    def bid(self, message):
        return Bid(0.9, (self.p.v_max, 0.35))


class Deaf(Racer):
    """Has never heard of a limit."""

    name = "deaf"
    launched_with = ()


class Wrong(Racer):
    name = "wrong"
    launched_with = ("v_maxx",)


class Rover(Robot):
    name = "rover"
'''
NAMES = ("racer", "deaf", "wrong", "rover")
LIMIT = 0.3
RUN = Scenario(
    name="elsewhere",
    world="empty",
    sensors="ideal",
    start=(0.0, 0.0, 0.0),
    goal=(50.0, 0.0, 0.0),
    agents=("encoder", "sonar", "racer", "interface"),
    v_max=LIMIT,
)
ABRUPT = Options(exchange="abrupt")


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    (tmp_path / "elsewhere_agents.py").write_text(AGENTS)
    info = tmp_path / "elsewhere_agents-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: elsewhere_agents\nVersion: 1.0\n")
    entries = "".join(f"{name} = elsewhere_agents:{name.capitalize()}\n" for name in NAMES)
    (info / "entry_points.txt").write_text(f"[armadico.agents]\n{entries}")
    monkeypatch.syspath_prepend(tmp_path)
    yield
    sys.modules.pop("elsewhere_agents", None)


def with_agent(name: str) -> Scenario:
    return replace(RUN, agents=tuple(name if a == "racer" else a for a in RUN.agents))


def driven(scenario: Scenario, options: Options) -> tuple[Rehearsal, list[float]]:
    """A run of some seconds, and the true speeds."""
    rehearsal = Rehearsal(scenario, options)
    speeds: list[float] = []

    def keep(_key: str, message: Message, _now: float) -> None:
        assert isinstance(message, Truth)
        speeds.append(message.v)

    rehearsal.mesh.watch(keep, Truth)
    rehearsal.start()
    rehearsal.begin()
    rehearsal.mesh.run(rehearsal.mesh.now + 10.0)
    return rehearsal, speeds


def test_it_is_told_the_speed_limit_and_the_exchange_live_and_virtual_alike() -> None:
    (member,) = (m for m in members(RUN, ABRUPT, "memory:") if m.name == "racer")
    assert member.sets == ("v_max=0.3", "social.exchange=abrupt")
    words = agent_words([member], "robot1")
    assert words[4:] == ["--set", "v_max=0.3", "--set", "social.exchange=abrupt"]
    rehearsal, speeds = driven(RUN, ABRUPT)
    parameters = rehearsal.mesh.node("racer").agent.p
    assert (parameters.v_max, parameters.social.exchange) == (LIMIT, "abrupt")  # type: ignore[attr-defined]
    assert 0.9 * LIMIT < max(speeds) < 1.1 * LIMIT


def test_who_has_not_heard_of_a_limit_drives_no_faster_and_the_same_arc() -> None:
    rehearsal, speeds = driven(with_agent("deaf"), ABRUPT)
    node = rehearsal.mesh.node("deaf")
    assert node.agent.p.v_max == 0.7  # type: ignore[attr-defined]
    assert 0.9 * LIMIT < max(speeds) < 1.1 * LIMIT
    state = rehearsal.watch.view.state
    assert state is not None
    assert state.w / state.v == pytest.approx(0.35 / 0.7, rel=0.1)
    assert rehearsal.watch.holder == "deaf", "it is obeyed, only slower"


def test_the_robot_agent_is_whoever_owns_the_wheels_whatever_its_name() -> None:
    scenario = replace(RUN, agents=("racer", "rover", "encoder"))
    assert names(scenario) == ("rover", "racer", "encoder")
    assert names(scenario, ("racer",)) == ("rover", "encoder")
    first, *_ = members(scenario, Options(), "tcp://127.0.0.1:1")
    assert first.sets == ("port=tcp://127.0.0.1:1", "profile=pioneer-2dx", "v_max=0.3")
    assert owns_wheels("encoder+rover")
    assert not owns_wheels("encoder+racer")


def test_a_host_is_told_of_its_own_agents_only_and_needs_no_others() -> None:
    host = Host(agents=("racer", "encoder"))
    scenario = replace(RUN, agents=("racer", "encoder", "not-installed-here"))
    here = share(scenario, Options(), host, ("deaf",))
    assert [member.name for member in here] == ["racer", "encoder", "deaf"]


def test_another_robot_agent_drives_the_thesis_scenario() -> None:
    result = Rehearsal(
        replace(
            RUN, agents=(*with_agent("goto").agents, "rover"), world="sc1", goal=(5.0, 1.0, 0.0)
        ),
        Options(),
    ).run()
    assert result.passed
