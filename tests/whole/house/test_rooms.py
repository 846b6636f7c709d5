"""The rooms of the framework, the lower first: each imports only itself and those below it."""

from __future__ import annotations

from collections import Counter

import pytest

from tests.whole.house.tree import PARTS, imports, modules, within

ROOMS = (
    *("core", "mobile", "config", "bridge", "mesh", "runtime", "observe", "gateways"),
    *("launch", "cli", "testing"),
)
"""What decides; what a mobile robot is; what is configured; the robot; how it talks; one process;
what looks at a society; what shows one to other tools; many processes; commands; what plug-ins are
tested with. A launcher measures what it runs, so that looking is below launching."""

DOORS = {
    # The public surface; see tests/whole/house/test_surface.py.
    "armadico": set(ROOMS) - {"bridge", "testing", "gateways", "cli"},
    "armadico.__main__": {"cli"},
    "armadico.child": {"cli"},
}
"""Of no room, and where they lead."""

LABORATORY = "armadico_tools"
"""What a robot's computer does without: another distribution, which nothing of ours imports."""


def room(module: str) -> str:
    """The room of a module, or nothing."""
    parts = module.split(".")
    return parts[1] if parts[0] == "armadico" and len(parts) > 1 and parts[1] in ROOMS else ""


def arrows() -> list[tuple[str, str]]:
    """Who imports whom, of our own."""
    return [(name, other) for name in modules() for other in imports(name) & modules().keys()]


def test_everything_of_the_framework_is_in_a_room() -> None:
    apart = (*(f"armadico.{part}" for part in PARTS if part not in ROOMS), LABORATORY)
    loose = {
        name
        for name in modules()
        if not room(name) and not any(within(name, part) for part in apart)
    }
    assert loose == set(DOORS)
    assert {room(name) for name in modules()} - {""} == set(ROOMS)


def test_a_room_imports_only_those_below_it() -> None:
    def allowed(name: str, other: str) -> bool:
        if room(other):
            return ROOMS.index(room(other)) <= ROOMS.index(room(name))
        return other in DOORS

    assert not [(a, b) for a, b in arrows() if room(a) and not allowed(a, b)]


@pytest.mark.parametrize("door", DOORS)
def test_a_door_leads_to_its_rooms(door: str) -> None:
    led_to = {room(name) for name in imports(door) & modules().keys() - DOORS.keys()} - {""}
    assert led_to == DOORS[door]


def test_nothing_of_the_product_imports_the_laboratory() -> None:
    users = {
        name
        for name, other in arrows()
        if within(other, LABORATORY) and not within(name, LABORATORY)
    }
    assert not users


def test_nothing_imports_in_a_circle() -> None:
    left = {name: imports(name) & modules().keys() - {name} for name in modules()}
    while done := {name for name, others in left.items() if not others & left.keys()}:
        left = {name: others for name, others in left.items() if name not in done}
    into = Counter(other for others in left.values() for other in others if other in left)
    while done := {name for name in left if not into[name]}:
        left = {name: others for name, others in left.items() if name not in done}
        into = Counter(other for others in left.values() for other in others if other in left)
    assert not left
