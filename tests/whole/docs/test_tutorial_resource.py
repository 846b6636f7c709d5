"""Promise 11: the tutorial's camera head, exactly as printed, is contested beside the wheels."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from armadico.config.scenarios import Scenario, load_scenario
from armadico.core.messages import Ack, Claim, Command, Message
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import Truth
from tests.whole.docs.shell import Shell
from tests.whole.docs.test_tutorial import FILES, NAMESPACE, do

HEAD = "camera-head"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder where the tutorial's agents have been installed, as it says."""
    with Shell(tmp_path_factory.mktemp("installed"), NAMESPACE) as shell:
        shell.write(FILES)
        do(shell, "head-install")
    return shell.folder


@pytest.fixture
def scenario(installed: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scenario]:
    """The scenario that the tutorial writes, with its agents."""
    monkeypatch.syspath_prepend(installed / "site")
    importlib.invalidate_caches()
    yield load_scenario(installed / "looking.toml")
    sys.modules.pop("camera_head", None)


class Seen:
    """A rehearsal, and what was published about the head and by the robot."""

    def __init__(self, scenario: Scenario, options: Options) -> None:
        self.rehearsal = Rehearsal(scenario, options)
        self.acks: list[Ack] = []
        self.talk: list[Message] = []
        self.truths: list[Truth] = []
        mesh = self.rehearsal.mesh
        mesh.watch(lambda _k, m, _t: self._keep(m), Ack, Claim, Command)
        mesh.watch(lambda _k, m, _t: self.truths.append(m), Truth)  # type: ignore[arg-type]

    def _keep(self, message: Message) -> None:
        if getattr(message, "resource", None) == HEAD:
            (self.acks if isinstance(message, Ack) else self.talk).append(message)  # type: ignore[arg-type]

    def holders(self) -> list[str]:
        return [ack.obeyed.instance.rsplit("-", 1)[0] for ack in self.acks if ack.obeyed]


@pytest.mark.long
def test_the_head_is_held_all_the_time_and_changes_hands_and_the_drive_is_the_same(
    scenario: Scenario,
) -> None:
    seen = Seen(scenario, Options(seed=3))
    assert seen.rehearsal.run().passed
    seconds = seen.rehearsal.mesh.now
    assert set(seen.holders()) == {"look-around", "look-there"}
    assert len(seen.holders()) > 0.9 * len(seen.acks), "it is not the wheels' ack that it looks at"
    assert len(seen.acks) == pytest.approx(5 * seconds, rel=0.05)
    assert len(seen.talk) <= 2.3 * len(seen.acks), "losers are silent"
    names = ("camera", "look-around", "look-there")
    without = Seen(scenario, Options(seed=3, without=names))
    without.rehearsal.run()
    assert without.truths == seen.truths[: len(without.truths)]


def test_the_head_moves_smoothly_and_stays_within_its_reach(scenario: Scenario) -> None:
    seen = Seen(scenario, Options(seed=4))
    seen.rehearsal.run()
    pans = [ack.measured[0] for ack in seen.acks]
    assert max(map(abs, pans)) <= 1.5  # type: ignore[arg-type]
    assert len(set(pans)) > 20, "it moves"


def test_a_second_camera_is_refused_and_told_whose_the_head_is(scenario: Scenario) -> None:
    rehearsal = Rehearsal(scenario, Options(seed=3))
    rehearsal.start()
    rehearsal.begin()
    first = rehearsal.mesh.node("camera")
    second = rehearsal.enter("camera")
    rehearsal.mesh.run(rehearsal.mesh.now + 3.0)
    assert first.alive
    assert not second.alive
    assert "camera" in second.driver.refusal
    assert first.agent.instance in second.driver.refusal


def test_whoever_holds_it_may_be_killed_and_without_its_owner_nobody_bids(
    scenario: Scenario,
) -> None:
    seen = Seen(scenario, Options(seed=3))
    rehearsal = seen.rehearsal
    rehearsal.start()
    rehearsal.begin()
    mesh = rehearsal.mesh
    mesh.run(60.0, lambda: seen.holders()[-1:] == ["look-there"])
    mesh.node("look-there").kill()
    mesh.run(mesh.now + 1.0)
    assert seen.holders()[-1] == "look-around"
    mesh.node("camera").kill()
    mesh.run(mesh.now + 3.0)
    said = len(seen.talk)
    mesh.run(mesh.now + 3.0)
    assert len(seen.talk) == said
