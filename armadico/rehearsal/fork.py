"""From the present to a virtual society: what is driven in each sample of a rehearsal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from dataclasses import replace as alike
from math import atan2, hypot, sqrt
from random import Random
from typing import Final, Literal

from msgspec import Struct

from armadico.config.loading import load_parameters
from armadico.config.moving import Moving
from armadico.config.profile import Body, RobotProfile, load_profile
from armadico.config.scenarios import Battery, Scenario, society
from armadico.config.slots import slot
from armadico.config.worlds import Segment, World, distance, is_map, load_world
from armadico.core.config_errors import ConfigError, ConfigNameError
from armadico.core.discovery import agent_class, owners
from armadico.core.judgement import Answer, Judgement, unknown
from armadico.core.resources import WHEELS
from armadico.launch.options import Options
from armadico.launch.society import Member, names, with_sets
from armadico.mobile.geometry import Pose2, relative, wrap
from armadico.mobile.messages import COVARIANCE
from armadico.mobile.swept_path import Outline
from armadico.rehearsal.present import CELL_M, Present
from armadico.rehearsal.sight import Rate, Sight, fields, sides, through

OWN: Final = {
    *("port", "simulator", "namespace", "profile", "x", "y", "theta", "world", "resume", "exact"),
    *("start_m", "start_rad"),
}
"""Parameters that a rehearsal sets itself."""

KNOWN_M: Final = 0.25
"""An obstacle that is nearer to a wall of the map is that wall."""

CELL_REACH_M: Final = CELL_M / sqrt(2.0)
"""From the middle of a cell to its corners."""

GAP_M: Final = 0.7
"""Cells farther apart are different things: sonars see points half a metre apart."""

JOINED_M: Final = 0.5
"""Cells of one thing that are not farther apart have a wall between them."""

PERSON_M: Final = 0.7
"""A thing that is not larger may be a person."""

PASSED: Final = 0.1
"""From this share of rays through walls of the map on, the map is not trusted. Chosen."""

PERSON_RADIUS_M: Final = 0.25
LEAST_M, LEAST_RAD = 0.02, 0.01
"""Least standard deviations of the pose with which localization begins."""

PATH_PLANNER: Final = "path-planning"

TINY: Final = 1e-6
"""Numbers of a profile that differ by less are the same."""

DRAWS: Final = 50
"""Draws of a pose that is in no wall."""


class Errand(Struct, frozen=True, kw_only=True):
    """What is to be rehearsed: a goal, a mission, or else the present mission; and changes."""

    # x, y in m and a heading in rad; None as the heading: that of a straight line there.
    goal: tuple[float, float, float | None] | None = None
    mission: str | None = None  # A mission's name or file
    direct: bool = False  # to the goal on a straight line, as by `armadico goto --direct`
    without: tuple[str, ...] = ()  # agents that are left out
    sets: tuple[str, ...] = ()  # parameters that are set, AGENT.KEY=VALUE
    # Agents that are killed, with the times, s after the beginning.
    kills: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Fork:
    """A virtual society that begins at the present, but for what each sample draws."""

    scenario: Scenario  # begins at the estimated pose
    options: Options  # its options, without a seed
    # Of the pose: the robot truly begins at a pose drawn from it. Empty: it begins at the estimated
    # pose.
    covariance: tuple[float, ...]
    speeds: tuple[float, float]  # with which the robot begins, m/s and rad/s
    # Errors of the odometry, as in `Correction`; empty: not known, or there are none.
    wheels: tuple[float, ...]
    walls: tuple[Segment, ...]  # what the sensors have seen and the map does not have
    # Of this, what may be a person: its middle and its walls.
    people: tuple[tuple[tuple[float, float], tuple[Segment, ...]], ...]
    silent: tuple[str, ...]  # range sensors that report nothing, as those of the present robot
    kills: tuple[tuple[str, float], ...]  # as in `Errand`
    lacks: tuple[str, ...]  # what a positive answer would need and nobody knows
    unforked: tuple[str, ...]  # what the virtual society is without
    charged: bool  # whether the battery's charge is known; else a full one is driven with
    sight: Sight  # what is in sight now
    rate: Rate  # how often something stands that the map does not have
    # How many things off the map stand in it whose size is not known: by sonars all of them, by
    # laser those that may be people.
    vague: int


def fork(
    now: Present, errand: Errand, *, world: str | None = None, made: str | None = None
) -> Fork | Judgement:
    """The virtual society of a present with an errand; or why there can be none.

    `world` replaces the map that the society names; `made` is the file of the one that it makes
    meanwhile (`Present.grid`). Raises ConfigError for an errand that this society cannot have: an
    agent that does not take part, a parameter that there is not, a mission's file.
    """
    if now.agents:
        _check_names(now, errand)
    if now.ready.answer is not Answer.YES:
        return now.ready
    assert now.pose is not None, "else it is not ready"
    goal = errand.goal or (None if errand.mission else now.goal)
    if goal is None and errand.mission is None:
        raise ConfigError("nothing to rehearse: the robot has no mission now; name a goal")
    lacks = [each.lacks for each in now.agents if each.lacks and each.name not in errand.without]
    lacks, unforked = [*lacks, *now.lacks], [*now.unforked]
    absent = [name for name in now.absent if name not in errand.without]
    lacks[:0] = [f"what {name} does: it is not alive, and may be restarted" for name in absent]
    profile = _profile(now)
    if isinstance(profile, Judgement):
        return profile
    place = _world(now, world or (None if now.world else made))
    if isinstance(place, Judgement):
        return place
    named, chart = place
    if not chart.outlines:
        lacks.append("the surroundings: the society has no map")
    if len(now.covariance) != COVARIANCE:
        lacks.append("how well the pose is known")
    taking = _taking(now)
    if chart.outlines:
        taking = _without_makers(taking, lacks)
    scenario = Scenario(
        name="rehearsal",
        title=f"rehearsal in {chart.name}",
        world=named,
        start=(now.pose[0], now.pose[1], wrap(now.pose[2])),
        goal=None if goal is None else _goal(goal, now.pose),
        mission=errand.mission,
        plan=_plan(errand, goal is now.goal, taking, mapped=bool(chart.outlines)),
        agents=taking,
        redundant=_redundant(now),
        robot=profile,
        sensors=society().ideal.sensors if now.exact else "real",
        battery=Battery() if now.battery is None else Battery(charge=now.battery),
    )
    # One that takes part in every society cannot be left out: an answer would be of another one.
    for name in {*errand.without} & {*names(scenario, errand.without)}:
        raise ConfigError(f"without {name}: no society is without it; to end it: --kill {name}@0")
    kept = tuple(name for name in taking if name not in errand.without)
    options = Options(
        sets=(*_sets(now, kept, lacks), *_certainty(now, kept)),
        without=tuple(name for name in errand.without if name not in now.absent),
    )
    robot = load_profile(profile)
    _check_profile(now, robot, lacks)
    options = alike(options, sets=(*options.sets, *_top_speed(now, errand, kept, robot, unforked)))
    options = alike(options, sets=(*options.sets, *_checked(errand.sets, scenario, options)))
    walls, people, things = _seen(now, chart, robot.body, lacks)
    _check_map(now, chart, lacks)
    standing = (*chart.outlines, *walls, *(wall for _, own in people for wall in own))
    sight = Sight(fields(robot, now.pose, now.silent), standing)
    if people:
        unforked.append(
            f"which of {len(people)} things that are not on the map are people: each walks in half"
            " of the samples"
        )
    return Fork(
        scenario,
        options,
        now.covariance if len(now.covariance) == COVARIANCE else (),
        now.speeds,
        () if now.exact else now.wheels,
        walls,
        people,
        now.silent,
        errand.kills,
        tuple(dict.fromkeys(lacks)),
        tuple(dict.fromkeys(unforked)),
        now.battery is not None,
        sight,
        Rate(things, sight.area),
        things if robot.laser is None else len(people),
    )


# The society --------------------------------------------------------------------------------------


def _profile(now: Present) -> str | Judgement:
    """The robot's profile, as far as it is here."""
    for name in dict.fromkeys((now.profile, now.robot)):
        if not name:
            continue
        try:
            load_profile(name)
        except ConfigError:
            continue
        return name
    return unknown(
        f"the robot's profile {now.profile or now.robot!r} is not on this computer",
        "rehearse where its agents run",
    )


def _check_profile(now: Present, profile: RobotProfile, lacks: list[str]) -> None:
    """Whether the robot is as its profile on this computer says."""
    body, limits, about = profile.body, profile.limits, now.described
    if about is None or about.robot != profile.name:
        return
    here = {
        "cycle_s": profile.cycle_s,
        "front": body.front_m,
        "rear": body.rear_m,
        "half_width": body.width_m / 2,
        "w_max": limits.w_max,
        "v_accel": limits.v_accel,
        "v_decel": limits.v_decel,
        "w_accel": limits.w_accel,
        "w_decel": limits.w_decel,
        "watchdog_s": profile.watchdog_s,
    }
    there = {name: getattr(about, name) for name in here}
    differs = [
        f"{n} {there[n]:g}, here {here[n]:g}" for n in here if abs(there[n] - here[n]) > TINY
    ]
    if about.v_max > limits.v_max + TINY:
        differs.append(f"v_max {about.v_max:g}, here {limits.v_max:g}")
    if differs:
        lacks.append(f"the robot, which is not as its profile here: {'; '.join(differs)}")


def _top_speed(
    now: Present,
    errand: Errand,
    taking: Sequence[str],
    profile: RobotProfile,
    unforked: list[str],
) -> list[str]:
    """The top speed that the robot agent admits, if its guard or the mission lowers it."""
    about, robot = now.described, next(owners(taking, WHEELS), None)
    if about is None or robot is None or about.robot != profile.name:
        return []
    if about.v_max >= profile.limits.v_max or not hasattr(agent_class(robot).parameters, "v_max"):
        return []
    goes_on = errand.goal is None and errand.mission is None
    if not goes_on and now.mission_v_max is not None and about.v_max >= now.mission_v_max - TINY:
        unforked.append("the robot's top speed: the present mission's is lower, and hides it")
        return []
    return [f"{robot}.v_max={about.v_max!r}"]


def _world(now: Present, given: str | None) -> tuple[str, World] | Judgement:
    """The map that the agents have, by name or path, and as a world."""
    named = given or now.world
    if given is None and not now.world:
        named = "empty"
    try:
        found = load_world(named)
    except ConfigError as error:
        if given is not None:
            raise
        return unknown(
            f"the map {named!r} is not on this computer: {error}", "give it: --world MAP"
        )
    if not all(is_map(found, each) for each in now.maps):
        return unknown(f"the agents have another map than {named!r}", "give theirs: --world MAP")
    return named, found


def _check_names(now: Present, errand: Errand) -> None:
    """Raises ConfigNameError for an agent that neither takes part nor should."""
    for name in (*errand.without, *(name for name, _ in errand.kills)):
        if name not in now.names and not (name in errand.without and name in now.absent):
            raise ConfigNameError("agent", name, now.names)
    for name, _ in errand.kills:
        if name in errand.without:
            raise ConfigError(f"{name}: it is left out, and cannot be killed")


def _taking(now: Present) -> tuple[str, ...]:
    """The agents that take part, the robot agent first."""
    taking = [each.name for each in now.agents if each.installed]
    robot = next(owners(taking, WHEELS), None)
    first = [] if robot is None else [robot]
    return tuple(dict.fromkeys([*first, *taking]))


def _without_makers(taking: tuple[str, ...], lacks: list[str]) -> tuple[str, ...]:
    """The agents, with those that use a map in place of those that make one and plan on it."""
    slam, exploring = slot("slam"), slot("exploring")
    making = [name for name in taking if name in slam.besides]
    if not making:
        return taking
    making += [name for name in taking if name in exploring.besides]
    using = (*slam.without, *exploring.without)
    lacks.append(
        f"what {', '.join(making)} will find: the map made so far is driven with localization"
        " and path-planning"
    )
    kept = [name for name in taking if name not in making]
    return tuple(dict.fromkeys((*kept, *(name for name in using if name != "mapping"))))


def _plan(
    errand: Errand, present: bool, taking: tuple[str, ...], *, mapped: bool
) -> Literal["direct", "rooms", "seen"] | None:
    """How the path is made: by the path planner, without which a new goal is refused.

    The present goal of a society without one was sent on a straight line.
    """
    if errand.mission is not None:
        return None
    if errand.direct or (present and PATH_PLANNER not in taking):
        return "direct"
    return "rooms" if mapped else "seen"


def _redundant(now: Present) -> bool:
    driving = [each for each in now.agents if each.drives]
    return bool(driving) and all(each.instances > 1 for each in driving)


def _sets(now: Present, taking: tuple[str, ...], lacks: list[str]) -> list[str]:
    """The parameters of the agents as `--set` takes them."""
    found = []
    for each in now.agents:
        if each.name not in taking:
            continue
        kind = agent_class(each.name).parameters
        for one in each.sets or ():
            if one.partition("=")[0] in OWN:
                continue
            try:
                load_parameters(kind, None, [one])
            except ConfigError:
                lacks.append(f"the parameter {each.name}.{one}: this version does not have it")
            else:
                found.append(f"{each.name}.{one}")
    return found


def _certainty(now: Present, taking: tuple[str, ...]) -> list[str]:
    """The certainty of the pose with which localization begins."""
    if "localization" not in taking or len(now.covariance) != COVARIANCE:
        return []
    xx, _, _, yy, _, tt = now.covariance
    off = max(LEAST_M, sqrt(max(0.0, (xx + yy) / 2)))
    turned = max(LEAST_RAD, sqrt(max(0.0, tt)))
    return [f"localization.start_m={off:.6g}", f"localization.start_rad={turned:.6g}"]


def _checked(sets: tuple[str, ...], scenario: Scenario, options: Options) -> tuple[str, ...]:
    """The given settings. Raises ConfigError for one that an agent would refuse."""
    taking = [Member(name) for name in scenario.agents if name not in options.without]
    for member in with_sets(taking, sets):
        load_parameters(agent_class(member.name).parameters, None, member.sets)
    return sets


def _goal(goal: tuple[float, float, float | None], here: Pose2) -> Pose2:
    x, y, theta = goal
    if theta is None:
        theta = atan2(y - here[1], x - here[0])
    return x, y, wrap(theta)


# Surroundings -------------------------------------------------------------------------------------


def _seen(
    now: Present, chart: World, body: Body, lacks: list[str]
) -> tuple[tuple[Segment, ...], tuple[tuple[tuple[float, float], tuple[Segment, ...]], ...], int]:
    """What stands where the map has nothing: walls, what may be a person, how many things."""
    assert now.pose is not None
    here, outlines, footprint = now.pose, chart.outlines, _footprint(body)
    new = [
        (x, y)
        for x, y in now.obstacles
        if all(distance(x, y, wall) > KNOWN_M for wall in outlines)
        and all(hypot(x - o.x, y - o.y) > o.radius + KNOWN_M for o in now.others)
    ]
    # A cell that is inside the footprint is the robot itself. One that its edge may cut is
    # something at the robot, which cannot stand there: the sample would begin with a contact.
    free = []
    for x, y in new:
        beside = footprint.beside(*relative(here, (x, y, 0.0))[:2])
        if beside >= CELL_REACH_M:
            free.append((x, y))
        elif beside > -CELL_REACH_M:
            lacks.append(f"what is within {CELL_M:g} m of the robot")
    walls: list[Segment] = []
    people = []
    things = _things(free)
    for thing in things:
        xs, ys = [x for x, _ in thing], [y for _, y in thing]
        size = max(max(xs) - min(xs), max(ys) - min(ys)) + CELL_M
        x, y = (min(xs) + max(xs)) / 2, (min(ys) + max(ys)) / 2
        own = (*(side for cell in thing for side in _box(*cell, CELL_M / 2)), *_joined(thing))
        own = tuple(wall for wall in own if not cuts(footprint, here, wall))
        apart = hypot(x - here[0], y - here[1]) - body.circle_m - PERSON_RADIUS_M
        if size <= PERSON_M and apart > 0 and chart.clearance(x, y) > PERSON_RADIUS_M:
            people.append(((x, y), own))
        else:
            walls += own
    for other in now.others:
        walls += _box(other.x, other.y, other.radius)
    return tuple(walls), tuple(people), len(things)


def _check_map(now: Present, chart: World, lacks: list[str]) -> None:
    """Whether the laser goes through walls of the map: they are gone, of glass, or elsewhere."""
    passed, met = through(now.rays, chart.outlines)
    if passed > PASSED * met:
        lacks.append(
            f"whether the map holds: {passed} of {met} rays of the laser go through its walls"
        )


def _things(cells: list[tuple[float, float]]) -> list[list[tuple[float, float]]]:
    """Cells that belong together."""
    left, found = list(cells), []
    while left:
        thing = [left.pop()]
        for at in thing:  # grows meanwhile
            near = [c for c in left if hypot(c[0] - at[0], c[1] - at[1]) <= GAP_M]
            thing += near
            left = [c for c in left if c not in near]
        found.append(thing)
    return found


def _joined(thing: list[tuple[float, float]]) -> Iterator[Segment]:
    """Walls between the cells of a thing that are not neighbours, and near."""
    for k, (x, y) in enumerate(thing):
        for a, b in thing[k + 1 :]:
            if 2 * CELL_M < hypot(x - a, y - b) <= JOINED_M:
                yield (x, y, a, b)


def _footprint(body: Body) -> Outline:
    return Outline(body.front_m, body.rear_m, body.width_m / 2)


def cuts(footprint: Outline, pose: Pose2, wall: Segment) -> bool:
    """Whether a part of a wall is inside the footprint at a pose, by Liang and Barsky's method."""
    x1, y1, *_ = relative(pose, (wall[0], wall[1], 0.0))
    x2, y2, *_ = relative(pose, (wall[2], wall[3], 0.0))
    low, high = 0.0, 1.0
    for at, step, least, most in (
        (x1, x2 - x1, -footprint.rear, footprint.front),
        (y1, y2 - y1, -footprint.half_width, footprint.half_width),
    ):
        if not step:
            if not least < at < most:
                return False
            continue
        ends = (least - at) / step, (most - at) / step
        low, high = max(low, min(ends)), min(high, max(ends))
    return low < high


def _box(x: float, y: float, half: float) -> tuple[Segment, ...]:
    return sides((x, y, 0.0), 2.0 * half, 2.0 * half)


# What a sample draws ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Drawn:
    """What one sample draws: the true start, what stands, and who walks."""

    start: Pose2
    walls: tuple[Segment, ...]
    people: tuple[Moving, ...]


def drawn_wheels(of: Fork, usual: Sequence[float], seed: int) -> tuple[float, ...]:
    """Errors of the odometry about what is estimated of them; empty: nothing is.

    As far off as the estimate may be, and at most as the profile's are: they are drawn evenly up to
    `usual`.
    """
    rng = Random(f"rehearsal/wheels/{seed}")
    known = zip(of.wheels[:3], of.wheels[3:], usual, strict=False)
    return tuple(rng.gauss(mean, min(off, most / sqrt(3.0))) for mean, off, most in known)


def draw(of: Fork, seed: int) -> Drawn:
    """Draw a sample's pose from the covariance, and which things are people."""
    rng = Random(f"rehearsal/{seed}")
    walls, people = [*of.walls], []
    for at, own in of.people:
        if rng.random() < 0.5:
            people.append(Moving(kind="person", at=at, radius=PERSON_RADIUS_M))
        else:
            walls += own
    chart = load_world(of.scenario.world)
    body = load_profile(of.scenario.robot).body
    start, standing = of.scenario.start, (*chart.outlines, *walls)
    # Where it can turn; near to something, where it is as clear of it as at the estimated pose.
    least = min((distance(*start[:2], wall) for wall in standing), default=body.circle_m)
    least = min(least, body.circle_m)
    for _ in range(DRAWS if of.covariance else 0):
        pose = _drawn(of.scenario.start, of.covariance, rng)
        clear = all(distance(*pose[:2], wall) >= least for wall in standing)
        if clear and not any(cuts(_footprint(body), pose, wall) for wall in standing):
            start = pose
            break
    return Drawn(start, tuple(walls), tuple(people))


def _drawn(mean: Pose2, covariance: tuple[float, ...], rng: Random) -> Pose2:
    """A pose by the Cholesky factor of its covariance."""
    xx, xy, xt, yy, yt, tt = covariance
    a = sqrt(max(xx, 0.0))
    b = xy / a if a else 0.0
    c = sqrt(max(yy - b * b, 0.0))
    d = xt / a if a else 0.0
    e = (yt - d * b) / c if c else 0.0
    f = sqrt(max(tt - d * d - e * e, 0.0))
    u, v, w = (rng.gauss(0.0, 1.0) for _ in range(3))
    return mean[0] + a * u, mean[1] + b * u + c * v, wrap(mean[2] + d * u + e * v + f * w)
