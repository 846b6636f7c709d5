"""List, add and remove the names of places: where `armadico goto kitchen` leads."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import Command, argument, flag, group, option

if TYPE_CHECKING:
    from armadico.config.named import Named
    from armadico.mobile.messages import Pose

POSE_S: Final = 2.0
"""How long the robot's pose is waited for, s."""

WHAT: Final = ("list", "add", "remove")

EXAMPLES: Final = """\
  armadico places                        rooms, goals and docks of the map, and added places
  armadico places add kitchen here       where the robot is now, with its heading
  armadico places add desk 4.2 1 90      x 4.2 m, y 1 m, heading 90 degrees
  armadico places remove desk
  armadico places --world office.map
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    what: str = argument("what to do (default: list)", nargs="?", choices=WHAT, default="list")
    name: str | None = argument("add, remove: the name", nargs="?", metavar="NAME")
    at: tuple[str, ...] = argument(
        "add: `here`, or X Y [DEG]: m, m, degrees", nargs="*", metavar="AT"
    )
    world: str | None = option(
        "the robot's world (default: that of the society that runs here)", metavar="MAP"
    )
    json: bool = flag("one JSON list on stdout")
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    if (args.what == "list") != (args.name is None):
        raise UsageError("expected list, add NAME here, add NAME X Y [DEG], or remove NAME")
    if args.at and args.what != "add":
        raise UsageError(f"{args.what}: {' '.join(args.at)!r} is one word too many")
    found = options.known_gazetteer(args.world, args.mesh.namespace)
    if args.what == "list":
        places = found.places
        if args.json:
            print(json.dumps([plain(place) for place in places]))
        for place in () if args.json else places:
            print(f"{options.shown(place.name):20} {place.sort:6} {_where(place)}")
        if not places and not args.json:
            print(f"{found.world.name} has no named places; `armadico places add NAME here`")
        return 0
    assert args.name is not None, "it was checked"
    if args.what == "remove":
        found.remove(args.name)
        print(f"{options.shown(args.name)} is removed from {found.file}")
        return 0
    found.add(args.name, _at(args))
    print(f"{_where(found.of(args.name))} is {options.shown(args.name)}, in {found.file}")
    return 0


def plain(place: Named) -> dict[str, object]:
    """A place for JSON: m and degrees."""
    heading = None if place.heading is None else round(math.degrees(place.heading), 1)
    at = {"x": round(place.x, 2), "y": round(place.y, 2), "heading_deg": heading}
    return {"name": place.name, "sort": place.sort.value, **at}


def _where(place: Named) -> str:
    turned = "" if place.heading is None else f", {math.degrees(place.heading):.0f} deg"
    return f"({place.x:.2f}, {place.y:.2f}){turned}"


def _at(args: Options) -> tuple[float, float, float | None]:
    """The pose to name, m, m, rad. Raises UsageError or FailedError."""
    if args.at == ("here",):
        pose = _pose(args)
        return pose.x, pose.y, pose.theta
    try:
        numbers = [float(word) for word in args.at]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3):
        words = " ".join(args.at)
        raise UsageError(f"add {args.name}: expected here, or X Y [DEG] (got {words!r})")
    x, y, *heading = numbers
    if heading and not abs(heading[0]) <= 360:
        raise UsageError(f"add {args.name}: expected a heading of -360 to 360 degrees")
    return x, y, math.radians(heading[0]) if heading else None


def _pose(args: Options) -> Pose:
    """The robot's present pose. Raises FailedError if it is not known well enough."""
    from armadico.mobile.behaviour import LOST_M
    from armadico.mobile.messages import Pose

    with args.mesh.client() as client:
        client.latest(Pose, POSE_S)
        pose = client.fresh(Pose)
    if pose is None:
        raise FailedError("the robot's pose is not known: is the society up?")
    if pose.deviation > LOST_M:
        raise FailedError(
            f"the robot is lost: its pose is known to +-{pose.deviation:.1f} m; give X Y [DEG]"
        )
    return pose


main: Final = Command(
    "armadico places",
    Options,
    run,
    "List, add and remove the names of places in the robot's world. `armadico goto`, the page and"
    " programs know them. Added places are kept in a file beside the map; those of a shipped world"
    " in your data folder.",
    EXAMPLES,
)
