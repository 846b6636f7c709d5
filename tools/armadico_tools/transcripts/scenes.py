"""The scenes: a robot's owner and two contenders, a few seconds each, and what befalls them."""

from __future__ import annotations

from typing import Any, Final

from msgspec import Struct
from msgspec.structs import replace

from armadico.core.messages import Claim, Command, Message, Stop
from armadico.core.services import service_of
from armadico.mesh.link_faults import WHOLE, LinkFaults
from armadico.mesh.virtual import VirtualMesh
from armadico_tools.transcripts.agents import Part, Step, agent_of
from armadico_tools.transcripts.tape import Recorder, Tape, Transcript

SEED: Final = 1

AFTER: Final = 0.02
"""What was sent before the end arrives within this, s."""

Act = tuple[float, str, Any]
"""When (s), what, and whom it befalls, or what is published."""


class Scene(Struct, frozen=True):
    """A scene as it is written: `loses` is the release that is lost."""

    name: str
    about: str
    ends: float
    parts: tuple[Part, ...]
    acts: tuple[Act, ...] = ()
    loses: type[Message] | None = None


ROBOT: Final = Part("robot", 0.0, owns=("wheels",))


def bidder(name: str, starts: float, *steps: Step) -> Part:
    """A contender for the wheels."""
    return Part(name, starts, competes_for=("wheels",), bids={"wheels": steps})


def a(*steps: Step) -> Part:
    """The one that drives first: 0.5 m/s straight ahead."""
    return bidder("a", 0.1, *(steps or (Step(1, 0.6, (0.5, 0.0)),)))


def b(*steps: Step) -> Part:
    """The other: 0.2 m/s and a turn."""
    return bidder("b", 0.5, *(steps or (Step(1, 0.4, (0.2, 0.3)),)))


OVER: Final = (Step(1, 0.6, (0.5, 0.0)), Step(13, None))
"""What is done in cycle 12."""

SCENES: Final = (
    Scene(
        "join",
        "The robot agent, then a, then b, look around, ask for cards, show their tokens, and listen"
        " for 3 cycles. No agent has been obeyed for as long as they know, so a takes the wheels."
        " b bids less, and publishes nothing.",
        1.6,
        (ROBOT, a(), replace(b(), starts=0.9)),
    ),
    Scene(
        "take-over",
        "a holds the wheels. From cycle 13 on b's bid is better by more than 0.05 than a's claim of"
        " the same cycle: b casts the next term, and a is silent. In cycle 18 a's bid is better by"
        " 0.05, which is not enough; in cycle 20 by 0.06.",
        2.4,
        (
            ROBOT,
            a(Step(1, 0.6, (0.5, 0.0)), Step(18, 0.95, (0.5, 0.0)), Step(20, 0.96, (0.5, 0.0))),
            b(Step(1, 0.4, (0.2, 0.3)), Step(13, 0.9, (0.2, 0.3))),
        ),
    ),
    Scene(
        "critical",
        "b is about to collide from cycle 13 on: as good as a will do, and a, as good but not"
        " critical, does not take the wheels back.",
        2.0,
        (ROBOT, a(), b(Step(1, 0.4, (0.2, 0.3)), Step(13, 0.6, (0.0, 0.3), critical=True))),
    ),
    Scene(
        "hand-over",
        "a has nothing to do from cycle 13 on, and releases by a command and a claim: b takes"
        " over.",
        2.0,
        (ROBOT, a(*OVER), b()),
    ),
    Scene(
        "hand-over-command-lost",
        "The same; the releasing command is lost. The claim reaches the robot agent and b.",
        2.0,
        (ROBOT, a(*OVER), b()),
        loses=Command,
    ),
    Scene(
        "hand-over-claim-lost",
        "The same; the releasing claim is lost. The command reaches the robot agent; its ack"
        " reaches b.",
        2.0,
        (ROBOT, a(*OVER), b()),
        loses=Claim,
    ),
    Scene(
        "offer",
        "a bids 0 from cycle 13 on: b takes over. From cycle 18 on b bids 0, and a bids nothing: b"
        " has offered for 4 cycles in cycle 21, and releases.",
        2.6,
        (
            ROBOT,
            a(Step(1, 0.6, (0.5, 0.0)), Step(13, 0.0, (0.1, 0.0)), Step(16, None)),
            b(Step(1, 0.4, (0.2, 0.3)), Step(18, 0.0, (0.1, 0.0))),
        ),
    ),
    Scene(
        "hang",
        "a hangs, and its last command is held up on the way. After 2.3 cycles b takes over. a"
        " returns, reads all that waited, and is silent; the command that comes late is refused."
        " Once a has listened for 3 cycles, its bid is the better one.",
        2.6,
        (ROBOT, a(), b()),
        acts=((1.45, "delay", "a"), (1.58, "hang", "a"), (1.6, "mend", "a"), (2.05, "return", "a")),
    ),
    Scene(
        "kill",
        "a is killed while it holds: its token goes, and b takes over before the next cycle.",
        2.0,
        (ROBOT, a(), b()),
        acts=((1.5, "kill", "a"),),
    ),
    Scene(
        "leave",
        "a ends in order while it holds: it releases, and its token goes.",
        2.0,
        (ROBOT, a(), b()),
        acts=((1.5, "leave", "a"),),
    ),
    Scene(
        "stop",
        "A peer stops the robot: all rest, no agent bids. It is released by a larger counter with"
        " the stop's press. A new stop with a smaller counter latches all the same, as the one"
        " known plus 1. Released again. The first stop comes once more, late: it is given back what"
        " is newer, and changes nothing.",
        3.4,
        (ROBOT, a(Step(1, 0.95, (0.5, 0.0))), b(Step(1, 0.05, (0.2, 0.3)))),
        acts=(
            (1.3, "publish", Stop(5, True, "somebody", 101)),
            (1.6, "publish", Stop(6, False, "somebody", 101)),
            (2.0, "publish", Stop(1, True, "somebody else", 102)),
            (2.5, "publish", Stop(8, False, "somebody else", 102)),
            (2.9, "publish", Stop(5, True, "somebody", 101)),
        ),
    ),
    Scene(
        "restart",
        "The robot is stopped, and its agent is killed. A new one is given the stop back before it"
        " begins. Once that is released, a and b have listened to the new epoch for 3 cycles, and a"
        " takes the wheels.",
        3.4,
        (ROBOT, a(), b(), Part("robot", 1.7, start=1, owns=("wheels",))),
        acts=(
            (1.3, "publish", Stop(1, True, "somebody", 101)),
            (1.5, "kill", "robot"),
            (2.7, "publish", Stop(2, False, "somebody", 101)),
        ),
    ),
    Scene(
        "restart-driving",
        "The robot agent is killed while a drives, and another starts: a new epoch. A tenure"
        " outlives its owner: a goes on with its ballot. For 3 cycles the new owner listens, and"
        " refuses; b listens, too.",
        3.0,
        (ROBOT, a(), b(), Part("robot", 1.7, start=1, owns=("wheels",))),
        acts=((1.5, "kill", "robot"),),
    ),
    Scene(
        "second-resource",
        "The lift, owned by hoist, has cycles of its own, 0.2 s each, which its ack numbers. a is"
        " better at the wheels, b at the lift; from the lift's cycle 10 on a bids 2.5 m, which is"
        " beyond its limits: a is not obeyed, stands back, and b is obeyed again.",
        3.8,
        (
            ROBOT,
            Part("hoist", 0.05, owns=("lift",)),
            Part(
                "a",
                0.1,
                competes_for=("wheels", "lift"),
                bids={
                    "wheels": (Step(1, 0.6, (0.5, 0.0)),),
                    "lift": (Step(1, 0.3, (0.5,)), Step(10, 0.9, (2.5,))),
                },
            ),
            Part("b", 0.2, competes_for=("lift",), bids={"lift": (Step(1, 0.7, (1.0,)),)}),
        ),
    ),
)


def transcribed(scene: Scene, seed: int = SEED) -> Transcript:
    """Let a scene happen."""
    mesh = VirtualMesh(seed)

    def lost(message: Message) -> bool:
        return type(message) is scene.loses and _releases(message)

    tape = Tape(mesh, lost)
    parts = tuple(
        replace(part, instance=mesh.identity(part.name, part.start).instance)
        for part in scene.parts
    )
    starts: list[Act] = [(part.starts, "start", part) for part in parts]
    for at, do, to in sorted([*starts, *scene.acts], key=lambda act: act[0]):
        mesh.run(at)
        _act(mesh, tape, do, to)
    mesh.run(scene.ends)
    tape.closed = True
    mesh.run(scene.ends + AFTER)
    lines = tuple(sorted(tape.lines, key=lambda line: line["t"]))
    return Transcript(scene.name, scene.about, seed, scene.ends, parts, lines)


def _releases(message: Message) -> bool:
    if isinstance(message, Command):
        return message.action is None
    return isinstance(message, Claim) and message.utility is None


def _start(mesh: VirtualMesh, tape: Tape, part: Part) -> None:
    agent = agent_of(part, mesh.seed)
    node = mesh.add(agent)
    node.driver = Recorder(agent, mesh.now, part.label, tape)
    tape.happens(part.label, "starts")


def _act(mesh: VirtualMesh, tape: Tape, do: str, to: Any) -> None:
    if do == "publish":
        tape.client(to, service_of(type(to)).key)
        return
    if do == "start":
        _start(mesh, tape, to)
        return
    node = mesh.node(to)
    if do == "delay":
        mesh.link(to, "robot").faults = LinkFaults(delay=0.7)
    elif do == "mend":
        mesh.link(to, "robot").faults = WHOLE
    elif do == "hang":
        tape.happens(to, "hangs")
        node.hang()
    elif do == "return":
        tape.happens(to, "returns")
        node.resume()
    else:
        line = tape.happens(to, "is killed" if do == "kill" else "leaves", to={})
        tape.token(to, alive=False, line=line)
        (node.kill if do == "kill" else node.leave)()
