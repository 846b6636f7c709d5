"""Rehearsals from Python: `armadico.rehearse`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext

from armadico.launch.client import Client, connect
from armadico.mesh.zenoh import ZenohMesh
from armadico.rehearsal.answer import Rehearsed
from armadico.rehearsal.fork import Errand
from armadico.rehearsal.rehearse import SAMPLES, WITHIN_S, rehearsed


def rehearse(
    goal: tuple[float, float] | tuple[float, float, float] | None = None,
    *,
    mission: str | None = None,
    without: Sequence[str] = (),
    sets: Sequence[str] = (),
    kills: Sequence[tuple[str, float]] = (),
    samples: int = SAMPLES,
    within_s: float = WITHIN_S,
    seed: int = 0,
    world: str | None = None,
    guest: Client | None = None,
    namespace: str | None = None,
) -> Rehearsed:
    """What would happen if the running society got an errand, before the robot moves.

        found = armadico.rehearse((8.0, 1.0), samples=8)
        found.says                        # "arrives in 4 of 4; in 41 s (39 to 44) over 17.2 m; ..."
        found.despite                     # (3, 4): with something put on the way, out of sight
        found.judgement.passed, found.small

    Several virtual societies are made of what the running one knows now, and driven on spare cores.
    The running one is only observed.

    Args:
        goal: x and y in m and a heading in rad; without it that of a straight line. None: the
            mission, or the present mission goes on.
        mission: A mission of several tasks: a shipped one, or a file.
        without: Agents to leave out.
        sets: Parameters to set, AGENT.KEY=VALUE.
        kills: Agents to kill, with the times, s after the beginning.
        samples: How many societies are driven.
        within_s: The answer comes after so long; what has not ended by then is unknown.
        seed: Seed of the first sample.
        world: The map, if it is not on this computer under the name that the society has.
        guest: A guest of the society (`armadico.connect`); None: one is made.
        namespace: The robot, if there is no guest; by default $ARMADICO_NAMESPACE, or robot1.

    Raises:
        ConfigError: The errand cannot be this society's, such as an agent that does not take part.
        MeshError: The mesh cannot be joined.
        TypeError: `guest` is on a virtual mesh.
    """
    x, y, *heading = (0.0, 0.0) if goal is None else goal
    errand = Errand(
        goal=None if goal is None else (x, y, heading[0] if heading else None),
        mission=mission,
        without=tuple(without),
        sets=tuple(sets),
        kills=tuple(kills),
    )
    with nullcontext(guest) if guest is not None else connect(namespace) as there:
        if not isinstance(there.mesh, ZenohMesh):
            raise TypeError("guest: expected a guest of a running society, of armadico.connect")
        return rehearsed(
            there.mesh, errand, samples=samples, within_s=within_s, seed=seed, world=world
        )
