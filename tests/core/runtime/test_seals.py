"""A repeated state counts only if its author signed it, under its key, and not too long ago."""

from __future__ import annotations

import hashlib

import pytest
from msgspec.structs import replace

from armadico.core.messages import Repeat, Stop, encode
from armadico.mesh.door import Door
from armadico.mobile.messages import Origin, Trajectory
from armadico.runtime.seals import LIFE_S, Seals

KEY = "trajectory/interface-00000000000000aa"
MISSION = Trajectory(3, 7, ())
AT = 1_800_000_000.0


def tag(name: str, data: bytes) -> bytes:
    return hashlib.sha256(name.encode() + data).digest()


class Clock:
    now = AT

    def __call__(self) -> float:
        return self.now


def seals(*agents: str, name: str | None = None, clock: Clock | None = None) -> Seals:
    """A process's, with a keyed hash in place of signatures."""
    own = name or "+".join(agents)

    class Hashes(Door):
        def sign(self, data: bytes) -> bytes:
            return tag(own, data)

        def verify(self, name: str, data: bytes, signed: bytes) -> bool:
            return signed == tag(name, data)

    return Seals(Hashes(f"robot1/{own}", {}), agents, clock or Clock())


def sealed(by: Seals, key: str = KEY) -> Repeat:
    found = by.seal(key, MISSION, encode(MISSION))
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("agents", "name"),
    [(("interface",), None), (("encoder", "interface"), None), (("interface", "robot"), "robot")],
)
def test_what_an_author_signs_counts_for_all(agents: tuple[str, ...], name: str | None) -> None:
    found = sealed(seals(*agents, name=name))
    assert (found.key, found.payload) == (KEY, encode(MISSION))
    assert seals("goto").fault(found) == ""


def test_nothing_of_it_can_be_changed_and_no_other_agent_can_sign_it() -> None:
    found, judge = sealed(seals("interface")), seals("sonar")
    for changed in (
        replace(found, payload=encode(Trajectory(4, 7, ()))),
        replace(found, key="trajectory/interface-00000000000000ab"),
        replace(found, key="mission/board/interface-00000000000000aa"),
        replace(found, until=found.until + 1),
        replace(found, signature=b""),
        replace(found, author="goto"),
        sealed(seals("goto")),
        sealed(seals("goto", "interface", name="goto")),
        Repeat(KEY, encode(MISSION)),
    ):
        assert judge.fault(changed) in (
            "it is not signed by its author",
            "it is not signed by its author, by a key that counts",
            "its signature has expired",
        )


def test_a_signature_expires() -> None:
    clock = Clock()
    found, judge = sealed(seals("interface")), seals("sonar", clock=clock)
    clock.now = AT + LIFE_S
    assert judge.fault(found) == ""
    clock.now = AT + LIFE_S + 1.0
    assert judge.fault(found) == "its signature has expired"


def test_the_same_is_signed_again_only_when_it_has_grown_old() -> None:
    clock = Clock()
    author = seals("interface", clock=clock)
    sealed(author)
    assert author.seal(KEY, MISSION, encode(MISSION)) is None
    assert author.seal(KEY, Trajectory(4, 7, ()), None) is not None
    sealed(author)
    clock.now = AT + LIFE_S / 2 + 1.0
    assert author.seal(KEY, MISSION, None) is not None


def test_a_stop_and_what_is_no_latched_state_of_its_own_are_not_signed() -> None:
    author = seals("encoder")
    assert author.seal("robot/stop/encoder-1", Stop(1, True, "encoder", 4), None) is None
    origin = Origin(1, 1, 1, 0, 0, 0, 0, 0, 0)
    assert author.seal("encoder/origin", origin, None) is None, "for agents of protocol 2"
    assert author.seal("encoder/origin/encoder-1", origin, None) is not None
