"""The variants of the workload, and that each of their kinds of faults takes effect."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import pytest

from armadico.core.config_errors import ConfigError
from armadico.core.kernel import Kernel
from armadico.core.messages import Claim, Command, Log, Message, RobotState
from armadico.mobile.messages import MissionState, MissionStatus, Pose, Truth
from armadico.mobile.obstacles import Obstacles
from armadico_tools.faults.fault_types import KINDS, Promise
from armadico_tools.faults.plan import AGENTS, Case, Fault, loads
from armadico_tools.faults.variants import ROOMS, VARIANTS, among, case_of, kinds_of, scenario_of
from armadico_tools.faults.workload import End, Workload, run

TRACED = (RobotState, Truth, Obstacles, Claim, Command, Pose, Log)

HERE, HOST = ("robot",), ("sonar", "avoid", "goto")

NEW = {
    "starved": Fault("starved", 6.0, 1.0, HOST, amount=0.1),
    "links-lost": Fault("links-lost", 6.0, 0.5, AGENTS, AGENTS),
    "silent-links": Fault("silent-links", 6.0, 0.8, AGENTS, ("robot",), 1.0),
    "biased-sonar": Fault("biased-sonar", 6.0, 2.0, HERE, amount=0.2),
    "repeating-sonar": Fault("repeating-sonar", 6.0, 2.0, HERE),
    "frozen-sonar": Fault("frozen-sonar", 6.0, 2.0, HERE),
    "silent-sonar": Fault("silent-sonar", 6.0, 2.0, HERE),
    "slip": Fault("slip", 6.0, 2.0, HERE, amount=1.5, spread=1.0),
    "blocked-wheels": Fault("blocked-wheels", 6.0, 1.0, HERE),
    "version-skew": Fault("version-skew", 6.0, 2.0, ("goto",)),
    "missing-wall": Fault("missing-wall", 1.0, 7.0, HERE, amount=0.4),
    "unmapped-box": Fault("unmapped-box", 1.0, 7.0, HERE, amount=0.1, spread=0.5),
}
LASER = {
    name: Fault(name, 6.0, 2.0, HERE, amount=amount)
    for name, amount in (
        *(("biased-laser", 0.2), ("glass", 1.0)),
        *((f"{how}-laser", 0.0) for how in ("silent", "frozen", "repeating")),
    )
}


def trace(case: Case) -> list[tuple[float, Message]]:
    """What robot and society publish in a case, with the times."""
    workload = Workload(case)
    found: list[tuple[float, Message]] = []
    workload.mesh.watch(lambda _, message, now: found.append((now, message)), *TRACED)
    workload.run()
    assert workload.error is None
    return found


@cache
def usual(robot: str) -> list[tuple[float, Message]]:
    """What is published if nothing is wrong."""
    return trace(Case(1, "rooms-a", 8.5, (), robot=robot))


def _differs(robot: str, fault: Fault) -> None:
    differs = usual(robot) != trace(Case(1, "rooms-a", 8.5, (fault,), robot=robot))
    assert differs  # without the two traces in the report


def test_a_case_is_one_run() -> None:
    same = usual("turtlebot4") == trace(Case(1, "rooms-a", 8.5, (), robot="turtlebot4"))
    assert same


@pytest.mark.long(but=("slip", "version-skew"))
@pytest.mark.parametrize("kind", NEW)
def test_a_kind_takes_effect(kind: str) -> None:
    _differs(Case(1, "rooms-a", 8.5, ()).robot, NEW[kind])


@pytest.mark.long(but=("glass",))
@pytest.mark.parametrize("kind", LASER)
def test_a_kind_of_lasers_takes_effect(kind: str) -> None:
    _differs("turtlebot4", LASER[kind])


def test_blocked_wheels_hold_the_robot_and_slipping_ones_show_another_speed() -> None:
    states: dict[str, list[tuple[float, float]]] = {}
    for kind in ("blocked-wheels", "slip"):
        workload = Workload(Case(1, "rooms-a", 7.0, (NEW[kind],)))
        seen = states[kind] = []
        plant = workload.rehearsal.robot.plant

        def keep(_key: str, _message: Message, now: float, seen=seen, plant=plant) -> None:  # type: ignore[no-untyped-def]
            if 6.5 < now < 6.95:
                seen.append((plant.speeds[0], plant.v))

        workload.mesh.watch(keep, Truth)
        workload.run()
    assert {true for true, _ in states["blocked-wheels"]} == {0.0}
    assert any(measured > 1.1 * true > 0.0 for true, measured in states["slip"])


def test_a_clock_step_of_a_host_is_that_of_all_its_agents() -> None:
    ahead = Fault("host-clock-step", 2.0, 1.0, HOST, amount=2.0)
    times: list[dict[str, float]] = []
    for faults in ((), (ahead,)):
        workload = Workload(Case(1, "sc1", 4.0, faults))
        workload.run()
        times.append({node.name: node.time for node in workload.mesh.nodes})
    usual, stepped = times
    off = {name: round(stepped[name] - at, 6) for name, at in usual.items()}
    assert {name for name, step in off.items() if step} == {*HOST}
    assert {off[name] for name in HOST} == {2.0}


@pytest.mark.long(but=("people",))
@pytest.mark.parametrize("variant", VARIANTS)
def test_a_seed_of_each_variant_runs(variant: str) -> None:
    case = case_of(1, 8.0, variant=variant)
    assert loads(case.dumps()) == case
    found = run(case)
    assert found.driven_m > 0.0
    assert {name for name, _, _ in found.violations} <= {Promise.COLLISION.name}


def test_the_seed_draws_variants_and_robots_and_a_choice_narrows_them() -> None:
    drawn = [case_of(seed, 30.0) for seed in range(60)]
    assert {case.variant for case in drawn} == {*VARIANTS}
    assert {"jackal", "turtlebot4", ""} <= {case.robot for case in drawn}
    chosen = [case_of(s, 30.0, scenario="house", robot="turtlebot4") for s in range(20)]
    assert {(case.scenario, case.robot) for case in chosen} == {("house", "turtlebot4")}
    assert len({case.variant for case in chosen}) > 1


def test_a_robot_has_the_faults_of_its_sensors_and_its_line() -> None:
    pioneer, _ = scenario_of(Case(1, "rooms-a", 9.0, ()))
    turtlebot, _ = scenario_of(Case(1, "rooms-a", 9.0, (), robot="turtlebot4"))
    there, here = {*kinds_of(pioneer)}, {*kinds_of(turtlebot)}
    assert {KINDS[kind].only for kind in there - here} == {"sonar", "serial"}
    assert {KINDS[kind].only for kind in here - there} == {"laser"}


def test_a_choice_that_nothing_fits_is_refused() -> None:
    with pytest.raises(ConfigError, match="no variant"):
        among("fleet", "rooms-a", None)
    with pytest.raises(ConfigError, match="nowhere"):
        among(None, "nowhere", None)


def test_an_agent_of_another_protocol_that_is_obeyed_is_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Planted: no agent checks the protocol of another."""
    fault = Fault("version-skew", 5.0, 9.0, ("goto",))
    others = tuple(Fault("crash", 6.0, 7.0, (name,)) for name in ("goto", "avoid", "gothrough"))
    case = Case(3, "sc4", 14.0, (fault, *others))
    assert not any("protocol" in text for _, _, text in run(case).violations)
    monkeypatch.setattr(Kernel, "met", lambda self, card, now: None)
    assert any("protocol" in text for _, _, text in run(case).violations)


@pytest.mark.parametrize("state", [MissionState.REACHED, MissionState.FAILED])
def test_a_mission_ends_when_the_society_says_so_and_is_counted(state: MissionState) -> None:
    """However long it takes, the bed gives up none."""
    workload = Workload(Case(1, ROOMS[0], 4.0, ()))
    workload.mesh.run(3.0)
    workload._order()
    status: list[MissionStatus] = []
    workload.mesh.watch(lambda _, message, __: status.append(message), MissionStatus)  # type: ignore[arg-type]
    workload.mesh.run(4.0)
    assert not workload.ends
    workload._on_status(MissionStatus(status[-1].mission, state, 0.0))
    workload._order()
    ended: Callable[[End], int] = workload.ends.__getitem__
    assert ended(End[state.name]) == 1
    assert sum(workload.ends.values()) == 1
