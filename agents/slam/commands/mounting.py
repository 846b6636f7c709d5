"""Measure from a log how the scanner is mounted and how the wheels err; compare the profile."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import ceil, degrees, radians, remainder, tau
from typing import TYPE_CHECKING, Final

from armadico.agents.slam.commands import log_file
from armadico.cli.parsing import Command, between, option
from armadico.core.config_errors import ConfigError
from armadico.core.judgement import Answer, Judgement, all_of, no, unknown, yes

if TYPE_CHECKING:
    from collections.abc import Callable

    from armadico.agents.slam.logs.logs import Log
    from armadico.agents.slam.mounting import Drive, Solution
    from armadico.config.profile import RobotProfile

LEAST_TURN_DEG, LEAST_WAY_M = 90.0, 2.0
"""A robot that turned or drove less tells nothing of what shows in turns or on the way."""

RECORD: Final = (
    "record a drive of some minutes among walls, with turns in place to both sides:"
    " armadico record FILE.mcap"
)

RARE: Final = "use a log with odometry at 2 Hz or more"

EXAMPLES: Final = """\
  armadico record drive.mcap                      on a live robot: drive 20 m, turn to both sides
  armadico mounting drive.mcap                    compare with the profile that it was recorded with
  armadico mounting drive.mcap --profile mine.toml
  armadico mounting rosbag2_lab --scan /scan --json
  armadico mounting intel.npz                     compare with the mounting that the log assumes
"""


@dataclass(frozen=True, kw_only=True)
class Options(log_file.LogOptions):
    drift: float | None = option(
        "add errors to the odometry, as a share of ways and turns (default: 0)",
        metavar="SHARE",
        must=between(0, 1),
    )
    profile: str | None = option(
        "compare with this robot (default: the one that a recording names, else what the log says)",
        metavar="PROFILE",
    )


@dataclass(frozen=True)
class Quantity:
    """What was measured, and how it compares. None: not known."""

    name: str
    unit: str
    expected: float | bool
    measured: float | bool | None
    interval: float | None  # half of the 95 % interval
    judgement: Judgement


@dataclass(frozen=True)
class Found:
    """All that was measured, for JSON."""

    quantities: Sequence[Quantity]
    compared_with: str  # "profile", or "log": the mounting that it assumes
    proposed: str  # lines of a profile
    pairs: int  # of scans that fitted,
    pairs_tried: int
    way_m: float
    turn_deg: float


def run(args: Options) -> int:
    from armadico.agents.slam import mounting
    from armadico.cli import options
    from armadico.cli.pool import progress

    say = options.reporter("armadico mounting")
    log, share = log_file.opened(replace(args, drift=args.drift or 0.0), say)
    if not log.real:
        say("note: the odometry is a corrected path: the wheels' errors are those of this path")
    profile = _profile(args, log, say)
    drive = mounting.drive_of(log, log.part(args.over))
    expected = None if drive is None else _expected(log, drive, profile)
    if drive is not None and expected is not None and log.cycles and profile is not None:
        turn = expected.bearing + expected.first - float(drive.mount[2])
        if abs(_wrap(turn)) > radians(1.0):
            say(
                "note: the recorded scans begin at another angle than those of the profile, by"
                f" {degrees(_wrap(turn)):.0f} degrees: bearing_deg or angle_min_deg was changed"
                " since; if angle_min_deg is not the driver's, the measured bearing is wrong by as"
                " much"
            )
    tried = [] if drive is None else mounting.chosen(drive)
    pairs, solution, why = [], None, yes()
    quantities: list[Quantity] = []
    with progress("match", len(tried)) as step:
        for scans in tried:
            assert drive is not None, "nothing is tried otherwise"
            pair = mounting.matched(drive, scans)
            pairs += [] if pair is None else [pair]
            step()
    if drive is None or expected is None:
        why = unknown("the log has no scans of a laser", RECORD)
    elif (solution := mounting.solve(drive, pairs)) is None:
        why = _too_few(len(pairs), len(tried))
    else:
        quantities = list(_compared(solution, expected, profile))
    judged = all_of([log.judgement, why, *(one.judgement for one in quantities)])
    lines = "\n".join(proposed(quantities))
    way, turn = (0.0, 0.0) if solution is None else (solution.way, solution.turn)
    against = "log" if profile is None else "profile"
    found = Found(quantities, against, lines, len(pairs), len(tried), way, degrees(turn))
    log_file.report(args, log, judged, found, _rows(found), share)
    if lines and not args.json:
        print(f"Lines for the profile:\n\n{lines}\n")
    return log_file.conclude(judged, f"the drive agrees with the {against}", say)


def _profile(args: Options, log: Log, say: Callable[[str], None]) -> RobotProfile | None:
    """The profile to compare with; None: the mounting that the log assumes. Raises ConfigError."""
    from armadico.config.profile import load_profile
    from armadico.launch.society import profile_of

    name = profile_of(args.profile) or log.profile
    if name is None:
        return None
    try:
        profile = load_profile(name)
        if profile.laser is None:
            raise ConfigError(f"profile {name!r} has no [laser] section")
    except ConfigError as error:
        if args.profile is not None:
            raise
        say(f"note: {error}; the mounting is compared with that of the recorded scans")
        return None
    return profile


def _too_few(fit: int, tried: int) -> Judgement:
    from armadico.agents.slam.mounting import LEAST_PAIRS

    if not tried:
        return unknown("the robot moved by less than 0.25 m and 15 degrees", RECORD)
    what = f"{fit} of {tried} pairs of scans fit on each other; at least {LEAST_PAIRS} are needed"
    return unknown(what, RECORD)


# Comparison ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Expected:
    """The mounting as the profile has it, or the log without one."""

    x: float
    y: float
    bearing: float  # rad
    upside_down: bool
    first: float  # the first ray's direction from the bearing, if the rays turn as assumed, rad
    turned_over: bool  # as the log assumes


def _expected(log: Log, drive: Drive, profile: RobotProfile | None) -> _Expected:
    from armadico.agents.slam.logs.logs import Scans

    laser, down = None if profile is None else profile.laser, drive.step < 0.0
    if isinstance(log.readings, Scans):
        first = log.readings.angles[0]
    elif laser is not None:
        first = radians(laser.angle_min_deg) * (-1.0 if down else 1.0)
    else:
        first = -0.5 * (drive.rays - 1) * drive.step
    if laser is not None:
        return _Expected(*laser.place, laser.upside_down, first, down)
    x, y, bearing = drive.mount.tolist()
    return _Expected(x, y, _wrap(bearing - first), down, first, down)


def _compared(
    solution: Solution, expected: _Expected, profile: RobotProfile | None
) -> Iterator[Quantity]:
    """Each quantity against what is expected."""
    from armadico.agents.slam.mounting import STUDENT
    from armadico.config.profile import WIDE

    alpha = WIDE if profile is None else profile.wheels
    x, y, yaw, turns, drift, ways, late = solution.values.tolist()
    halves = (STUDENT * solution.deviations).tolist()
    doubt, degrees_turned = yes(), degrees(solution.turn)
    if solution.contradict:
        why = "the wheels and the scans contradict each other: slip, jumps, or wrong times"
        doubt = unknown(why, RECORD)
    turning = straight = doubt
    if degrees_turned < LEAST_TURN_DEG:
        turning = unknown(f"the robot turned by {degrees_turned:.0f} degrees only", RECORD)
    if solution.way < LEAST_WAY_M:
        straight = unknown(f"the robot drove {solution.way:.1f} m only", RECORD)
    timed = doubt if solution.timed else unknown("the odometry is too rare to tell the time", RARE)
    mirrored = bool(solution.mirrored)
    bearing = _wrap(yaw - (-1.0 if mirrored else 1.0) * expected.first - expected.bearing)
    bearing += expected.bearing

    for name, unit, at, was, value, widest, near, known in (
        ("x_m", "m", 0, expected.x, x, 0.06, 0.03, turning),
        ("y_m", "m", 1, expected.y, y, 0.06, 0.03, turning),
        ("bearing_deg", "deg", 2, expected.bearing, bearing, 0.05, 0.035, straight),
        ("ways", "m/m", 5, 1.0, 1.0 + ways, 0.05, alpha.alpha3, straight),
        ("turns", "rad/rad", 3, 1.0, 1.0 + turns, 0.06, alpha.alpha1, turning),
        ("drift", "deg/m", 4, 0.0, drift, 0.05, alpha.alpha2, straight),
        ("stamps late", "s", 6, 0.0, late, 0.1, 0.05, timed),
    ):
        if at == 5:
            yield _turned_over(solution.mirrored, expected, turning)
        scale, half = degrees(1.0) if unit.startswith("deg") else 1.0, halves[at]
        shown, judged = f"{scale * half:.2g} {unit}", known
        if known.passed and half > widest:
            judged = unknown(f"{name}: the drive does not show it (± {shown})", RECORD)
        elif known.passed and abs(value - was) > max(near, half):
            judged = no(f"{name} is {scale * value:.3g} ± {shown}, not {scale * was:.3g}")
        if judged.answer is Answer.UNKNOWN:
            yield Quantity(name, unit, scale * was, None, None, judged)
        else:
            measured = degrees(_wrap(value)) if at == 2 else scale * value
            yield Quantity(name, unit, scale * was, measured, scale * half, judged)


def _turned_over(mirrored: bool | None, expected: _Expected, known: Judgement) -> Quantity:
    """Whether the scanner hangs upside down: its rays go clockwise on the robot."""
    if known.passed and mirrored is None:
        known = unknown("upside_down: the drive does not show it", RECORD)
    was, found = expected.upside_down, expected.turned_over is not mirrored
    if not known.passed:
        return Quantity("upside_down", "", was, None, None, known)
    judged = yes() if found is was else no(f"upside_down is {found}".lower())
    return Quantity("upside_down", "", was, found, None, judged)


def _wrap(angle: float) -> float:
    return remainder(angle, tau)


def proposed(quantities: Sequence[Quantity]) -> Iterator[str]:
    """The lines of a profile for what differs."""
    off = {one.name: one for one in quantities if one.judgement.answer is Answer.NO}
    if mount := [off[name] for name in ("x_m", "y_m", "bearing_deg", "upside_down") if name in off]:
        yield "[laser]"
        for one in mount:
            was = f"{one.expected:.3g}" if one.unit else str(one.expected).lower()
            if one.interval is None:
                yield f"{one.name} = {str(one.measured).lower()}  # not {was}"
            else:
                digits = 1 if one.unit == "deg" else 3
                about = f"± {one.interval:.2g}, not {was}"
                yield f"{one.name} = {one.measured:.{digits}f}  # {about}"
    wheels = {"turns": "alpha1", "drift": "alpha2", "ways": "alpha3"}
    if any(name in off for name in wheels):
        known = {one.name: one.measured for one in quantities if one.measured is not None}
        ways, turns = known.get("ways"), known.get("turns")
        if ways and turns:
            yield "# Better than these lines: in the robot's driver multiply the wheel radius by"
            yield f"# {ways:.3f} and the wheel separation by {ways / turns:.3f}."
        yield "[odometry]"
    for name, key in wheels.items():
        if name in off:
            one = off[name]
            error = abs((one.measured or 0.0) - one.expected)
            error = radians(error) if one.unit == "deg/m" else error
            yield f"{key} = {ceil(100.0 * error) / 100.0:.2f}"
    if (late := off.get("stamps late")) is not None:
        yield f"# The stamps of the scans are {late.measured:.2f} s late: set `stamped`, or correct"
        yield "# the clock of the laser's driver."


def _rows(found: Found) -> Iterator[tuple[str, str]]:
    yield "pairs of scans that fit, tried", f"{found.pairs}  {found.pairs_tried}"
    yield "between them: m, degrees", f"{found.way_m:.0f}  {found.turn_deg:.0f}"
    for one in found.quantities:
        said = {Answer.YES: "agrees", Answer.NO: "differs", Answer.UNKNOWN: "unknown"}
        text, was = "?", f"{one.expected:.3f}"
        if not one.unit:
            text, was = (str(value).lower() for value in (one.measured, one.expected))
            text = "?" if one.measured is None else text
        elif one.measured is not None:
            text = f"{one.measured:.3f} ± {one.interval:.3f}"
        label = f"{one.name}, {one.unit}" if one.unit else one.name
        yield label, f"{text}  {said[one.judgement.answer]}  ({found.compared_with} {was})"


main: Final = Command(
    "armadico mounting",
    Options,
    run,
    "Measure from a log how the laser is mounted, how the wheels err, and how late the scans are,"
    " and compare the profile: exit code 0 if all agrees, 1 if something differs, for which lines"
    " are proposed, 3 if something is not known. A live robot is recorded first, by `armadico"
    " record`. A log is an .npz file, a CARMEN log (also .gz), a recording or a ROS bag.",
    EXAMPLES,
)
