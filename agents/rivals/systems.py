"""The mechanisms by name, and the systems of the thesis's chapter 2 as presets of them.

A preset stands for how a system coordinates behaviours on one resource, the wheels, and for no more
of it: `lacks` says what is missing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from armadico.agents.rivals.executive import EXECUTIVE
from armadico.agents.rivals.fields import SCHEMAS
from armadico.agents.rivals.layers import SUBSUMPTION, TWIST_MUX
from armadico.agents.rivals.learned import EXPLORING, LEARNED
from armadico.agents.rivals.libraries import ARBITRATION_GRAPH, BEHAVIOUR_TREE
from armadico.agents.rivals.mechanisms import AUCTION, MEAN, PRIORITY, RESOLVER
from armadico.agents.rivals.operators import OPERATORS
from armadico.agents.rivals.proposer import Arbitrated
from armadico.agents.rivals.queues import MUTEX, QUEUE, RIGHT_OF_WAY
from armadico.agents.rivals.sequences import CONTRACT, MOTIVATION, SEQUENCING
from armadico.agents.rivals.tasks import ALLIANCE, CENTRAL, CONTRACT_NET
from armadico.agents.rivals.trust import TRUST
from armadico.agents.rivals.votes import CONSTRAINED, DAMN, FUZZY
from armadico.core.cycles import CycleClock
from armadico.core.individual import Individual
from armadico.core.mechanisms import Coordination
from armadico.core.resources import Resource

MECHANISMS: Final[dict[str, Arbitrated]] = {
    "arbitration-graph": ARBITRATION_GRAPH,
    "aria": RESOLVER,
    "auction": AUCTION,
    "behaviour-tree": BEHAVIOUR_TREE,
    "constrained": CONSTRAINED,
    "contract": CONTRACT,
    "damn": DAMN,
    "fuzzy": FUZZY,
    "mean": MEAN,
    "motivation": MOTIVATION,
    "operators": OPERATORS,
    "priority": PRIORITY,
    "schemas": SCHEMAS,
    "sequencing": SEQUENCING,
    "subsumption": SUBSUMPTION,
    "trust": TRUST,
    "twist-mux": TWIST_MUX,
}
"""Those for the wheels."""

ELSEWHERE: Final[dict[str, Coordination]] = {
    "alliance": ALLIANCE,
    "central": CENTRAL,
    "contract-net": CONTRACT_NET,
    "executive": EXECUTIVE,
    "mutex": MUTEX,
    "queue": QUEUE,
    "right-of-way": RIGHT_OF_WAY,
}
"""Those for tasks and passages between robots, the trajectory and the planner."""


@dataclass(frozen=True)
class System:
    """A system that chapter 2 names."""

    title: str  # its name there
    section: str  # the section there
    mechanism: str  # the mechanism that stands for it; empty: nothing can
    lacks: str  # what cannot be represented, or why nothing stands for it
    sets: tuple[str, ...] = ()  # parameters of the arbiter, KEY=VALUE
    # Whether it has sequencing only: by table 2.1 it does not coordinate behaviours, so it is not
    # to be ranked with the others.
    sequencing: bool = False


_SKILLS: Final = (
    'methods=[["teleop"],["relocate"],["avoid","gothrough","goto"],["gothrough","avoid","goto"],'
    '["goto","avoid","gothrough"]]',
    'within="mean"',
)

SYSTEMS: Final[dict[str, System]] = {
    "subsumption": System("Subsumption", "2.3", "subsumption", "the wiring within a layer"),
    "aura": System(
        "AuRA", "2.4.1", "schemas", "planner, cartographer, learning; gains change by the battery"
    ),
    "rap": System(
        "RAP",
        "2.2",
        "sequencing",
        "the task net: one level of methods here",
        ("patience_s=20",),
        sequencing=True,
    ),
    "atlantis": System(
        "ATLANTIS",
        "2.4.2",
        "sequencing",
        "the deliberator, which advises; semaphores of other resources",
        sequencing=True,
    ),
    "sss": System(
        "SSS",
        "2.4.3",
        "sequencing",
        "the servo layer; suppression and inhibition; the symbolic layer's map: events come from"
        " the behaviours' utilities",
        ("patience_s=600", "succeeds=0.5"),
    ),
    "tca": System(
        "TCA", "2.4.4", "constrained", "the task tree with monitors and exceptions; POMDP, PRODIGY"
    ),
    "damn": System(
        "DAMN", "2.4.5", "damn", "map-based utilities; an arbiter per degree of freedom"
    ),
    "3t": System(
        "3T", "2.4.6", "sequencing", "the planner; skills are averaged by utility", _SKILLS
    ),
    "berra": System(
        "BERRA",
        "2.4.7",
        "sequencing",
        "speech and gestures; a failure chooses another set, as TES does",
        (*_SKILLS[:1], "patience_s=4"),
    ),
    "yavuz": System(
        "Yavuz", "2.4.8", "fuzzy", "the modes of teaching and playing back", ('blend="or"',)
    ),
    "tripodal": System("Tripodal", "2.4.9", "priority", "the Petri net of tasks above it"),
    "saphira": System(
        "Saphira",
        "2.5.1",
        "fuzzy",
        "voice; artifacts of the local perceptual space; PRS-lite: utilities are the contexts",
    ),
    "ara": System("ARA", "2.5.2", "operators", "the tutor; learning"),
    "busquets": System(
        "Busquets",
        "2.5.3",
        "auction",
        "the camera, the second resource: a subclass of the auction decides about a user's",
        ("margin=0",),
    ),
    "socio-intentional": System(
        "Socio-intentional",
        "2.5.4",
        "contract",
        "goals in i*; the text has no formula: contract net is the nearest",
        ("tenure_s=1.0",),
        sequencing=True,
    ),
    "vomas": System(
        "VOMAS",
        "2.5.5",
        "damn",
        "migration of code; operators are replaced by a new mission (its wheelchair used DAMN)",
    ),
    "alliance": System("ALLIANCE", "2.6.4", "alliance", "L-ALLIANCE's learning"),
    "nerd-herd": System(
        "Nerd Herd", "2.6.3", "schemas", "other robots; basic behaviours are summed", ("noise=0",)
    ),
    "artis": System(
        "ARTIS example",
        "2.7.1",
        "priority",
        "hard real time; the deadline is the arbiter's 20 ms, without an optional part",
        ("suppression_s=0",),
    ),
    "aria": System("ARIA", "2.7.6", "aria", "channels for speed and heading; limits"),
    "missionlab": System("MissionLab", "2.7.6", "schemas", "assemblages chosen by automata"),
    "teambots": System("TeamBots", "2.7.6", "schemas", "Clay's sequencing; its Java runtime"),
    "pyro": System("Pyro", "2.7.6", "fuzzy", "its other brains", ('blend="or"',)),
    "o2ca2": System("O2CA2", "2.8.1", "mean", "the vehicle; the automaton of the plan"),
    "dpaa": System(
        "DPAA",
        "2.8.2",
        "contract",
        "dialogues between modules; introspection is the robot's limits",
    ),
    "rogi": System(
        "RoGi", "2.8.3", "contract", "soccer; the benefit is the utility", ("tenure_s=0.2",)
    ),
    "armadico": System("ARMADiCo", "3.10", "", "the default: leave out --coordination"),
    "actress": System("ACTRESS", "2.6.1", "", "negotiation between robots, by messages"),
    "cebot": System("CEBOT", "2.6.2", "", "bodies that dock; a genetic algorithm configures them"),
    "swarm-bots": System("Swarm-bots", "2.6.5", "", "evolved controllers of bodies that dock"),
    "oaa": System("OAA", "4.3.1", "", "a platform of communication"),
    "simba": System("SIMBA", "2.7.1", "", "a platform: agents of ARTIS beside others"),
    "orocos": System("OROCOS", "2.7.2", "", "a platform: real-time libraries"),
    "idea": System("IDEA", "2.7.3", "", "a platform: planning of tokens, none of behaviours"),
    "roci": System("ROCI", "2.7.4", "", "a platform: modules and their wiring"),
    "claraty": System("CLARAty", "2.7.5", "", "a platform: layers of components"),
    "player": System("Player/Stage", "2.7.6", "", "a platform: devices; the last command counts"),
    "carmen": System("CARMEN", "2.7.6", "", "a platform: one navigator drives"),
    "ade": System("ADE", "2.7.6", "", "a platform: components may use any arbitration"),
    "miro": System("Miro", "2.7.6", "", "a platform: services over CORBA"),
    "marie": System("MARIE", "2.7.6", "", "a platform: it joins programs of others"),
}
"""By the name for `--coordination`."""


def _preset(system: System) -> Arbitrated:
    mechanism = MECHANISMS[system.mechanism]
    only = ", sequencing only" if system.sequencing else ""
    about = f"{system.title} (thesis, {system.section}): {system.mechanism}{only}"
    sets = (*mechanism.sets, *system.sets)
    return replace(mechanism, sets=sets, about=about, without=system.lacks)


@dataclass(frozen=True)
class Unrepresented:
    """The name of a system that no mechanism stands for, so it is not taken for a typing error."""

    absent: str  # why it cannot be chosen
    arbiter: str = ""  # none

    def contender(self, _resource: Resource, _agent: Individual, _clock: CycleClock) -> None:
        """Return None: it decides nothing."""


def _unrepresented(system: System) -> Unrepresented:
    return Unrepresented(
        f"nothing to choose: {system.title} (thesis, {system.section}), {system.lacks}"
    )


AVAILABLE: Final[dict[str, Coordination]] = {
    **{n: _preset(system) for n, system in SYSTEMS.items() if system.mechanism in MECHANISMS},
    **MECHANISMS,
    "exploring": EXPLORING,
    "learned": LEARNED,
    **ELSEWHERE,
}

COORDINATIONS: Final[dict[str, Coordination]] = {
    **AVAILABLE,
    **{n: _unrepresented(system) for n, system in SYSTEMS.items() if not system.mechanism},
}
"""Those, and the names of systems that cannot be chosen."""
