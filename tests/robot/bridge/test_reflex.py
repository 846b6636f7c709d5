"""The robot agent's reflex: no command passes that its own newest readings do not admit."""

from __future__ import annotations

from math import cos, inf, radians, sin, tau

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from armadico.bridge.p2os.commands import Cmd
from armadico.bridge.reflex import REPORT_S, Reflex
from armadico.bridge.seen import HEARD_M, KEPT_S, SHARE, Seen, met_within
from armadico.config.profile import RobotProfile, load_profile
from armadico.core.config_errors import ConfigError
from armadico.core.cycles import LISTEN
from armadico.core.messages import Cycle
from armadico.mobile.admissible import CREEP_M_S
from armadico.mobile.messages import Echo, Scan
from armadico.mobile.scans import message_of
from tests.robot.bridge.kit import PROFILE
from tests.robot.bridge.robot_bench import Bench

FRONT = PROFILE.body.front_m
ORIGIN = (0.0, 0.0, 0.0)
RING = range(len(PROFILE.ring.sonars))


def echo(distance: float | None, index: int = 3) -> Echo:
    sonar = PROFILE.ring.sonars[index]
    return Echo(sonar.x_m, sonar.y_m, radians(sonar.bearing_deg), distance)


def all_round(**echoes: float) -> list[Echo]:
    """A turn of the ring: nothing, but for sonars with a range, by number (`s3=0.4`)."""
    return [echo(echoes.get(f"s{index}"), index) for index in RING]


def reflex_of(measured: tuple[float, float] = (0.0, 0.0), **echoes: float) -> Reflex:
    """After a turn of the ring, at a constant speed."""
    reflex = Reflex(PROFILE)
    for now in (0.0, 0.1):
        reflex.update(all_round(**echoes), ORIGIN, measured, now)
    return reflex


@settings(max_examples=40)
@given(st.floats(0.15, 5.0), st.floats(0.0, 0.6))
def test_it_stops_before_an_obstacle_ahead(away: float, v: float) -> None:
    """However often it is asked, and however fast it is told to drive."""
    reflex, x, speed, now = Reflex(PROFILE), 0.0, v, 0.0
    wall = PROFILE.ring.sonars[3].x_m + away
    for _ in range(40):
        now += 0.1
        left = wall - x - PROFILE.ring.sonars[3].x_m
        reflex.update(all_round(s3=left, s4=left), (x, 0.0, 0.0), (speed, 0.0), now)
        wanted = reflex.cap(v, 0.0)[0]
        down, up = PROFILE.limits.v_decel, PROFILE.limits.v_accel
        speed = max(wanted, speed - 0.1 * down) if wanted < speed else min(wanted, speed + 0.1 * up)
        x += 0.1 * speed
        if x + FRONT >= wall:
            assert v * 0.3 + v * v / (2.0 * down) > away - 0.05, "it was too late from the start"
            return


def test_no_faster_than_it_has_seen() -> None:
    assert reflex_of((0.5, 0.0)).cap(0.5, 0.0) == (0.5, 0.0)
    blind = Reflex(PROFILE)
    blind.update((), ORIGIN, (0.5, 0.0), 0.0)
    blind.update((), ORIGIN, (0.5, 0.0), 0.1)
    v, _ = blind.cap(0.5, 0.0)
    assert v <= CREEP_M_S
    assert blind.why
    backing = reflex_of((-0.5, 0.0))
    assert abs(backing.cap(-0.5, 0.0)[0]) <= CREEP_M_S, "no sonar looks back"


def test_backwards_it_drives_as_fast_over_what_it_has_just_left() -> None:
    reflex = Reflex(PROFILE)
    for step in range(20):
        pose = 0.05 * step, 0.0, 0.0
        reflex.update(all_round(), pose, (0.5, 0.0), 0.1 * step)
    for step in range(2):
        reflex.update(all_round(), (0.95, 0.0, 0.0), (-0.3, 0.0), 2.0 + 0.1 * step)
    assert reflex.cap(-0.3, 0.0) == (-0.3, 0.0)


@pytest.mark.parametrize(("index", "to"), [(0, 1.0), (7, -1.0)], ids=["left", "right"])
def test_a_corner_turns_into_nothing_that_was_heard_beside_the_robot(index: int, to: float) -> None:
    reflex = Reflex(PROFILE)
    for step in range(10):  # along a wall, 4 cm beside the body
        pose = 0.05 * step, 0.0, 0.0
        reflex.update(all_round(**{f"s{index}": 0.07}), pose, (0.5, 0.0), 0.1 * step)
    for now in (1.0, 1.1):
        reflex.update((), (0.45, 0.0, 0.0), (0.0, 0.6 * to), now)
    assert abs(reflex.cap(0.0, 1.0 * to)[1]) < 1.0
    assert reflex.cap(0.0, 0.0) == (0.0, 0.0)


def test_an_obstacle_stays_where_it_was_until_it_is_looked_through() -> None:
    near = {"s3": 0.3, "s4": 0.3}
    reflex = reflex_of((0.5, 0.0), **near)
    assert reflex.cap(0.5, 0.0)[0] < 0.5
    for now in (0.2, 0.3):  # no sonar fired
        reflex.update((), ORIGIN, (0.5, 0.0), now)
    assert reflex.cap(0.5, 0.0)[0] < 0.5
    reflex.update(all_round(), ORIGIN, (0.5, 0.0), 0.4)
    assert reflex.cap(0.5, 0.0)[0] < 0.5, "one echo may be lost"
    for now in (0.8, 0.9):
        reflex.update(all_round(), ORIGIN, (0.5, 0.0), now)
    assert reflex.cap(0.5, 0.0) == (0.5, 0.0)
    old = reflex_of((0.5, 0.0), **near)
    for late in (0.1, 0.2):
        old.update((), ORIGIN, (0.5, 0.0), KEPT_S + late)
    assert old.cap(0.5, 0.0)[0] < 0.5, "too near to be forgotten"
    for late in (0.3, 0.4):
        old.update((), (-1.0, 0.0, 0.0), (0.5, 0.0), KEPT_S + late)
    assert len(old._seen.view(2.0).points) == 0


def test_a_door_that_the_body_fits_through_is_passed_as_fast_as_the_behaviours_like() -> None:
    """Posts of a door of 0.7 m, detected by the sonars that face past them."""
    posts = {f"s{index}": 0.4 for index in (1, 6)}
    assert reflex_of((0.5, 0.0), **posts).cap(0.5, 0.0) == (0.5, 0.0)


def test_a_wall_nearer_than_the_least_range_stays_where_it_was_heard() -> None:
    """At the least range, 0.1 m, each echo sounds like 0.1 m."""
    reflex, ahead = Reflex(PROFILE), PROFILE.ring.sonars[3].x_m
    wall = ahead + 0.12
    for step in range(20):
        x = min(0.04, 0.01 * step)  # it stops 3.6 cm before the wall
        heard = max(0.1, wall - x - ahead)
        reflex.update(all_round(s3=heard, s4=heard), (x, 0.0, 0.0), (0.0, 0.0), 0.1 * step)
    assert reflex.cap(0.6, 0.0)[0] < 0.05
    assert reflex.cap(-0.1, 0.0) == (-0.1, 0.0)


def test_what_is_first_heard_at_the_least_range_may_be_at_the_body_already() -> None:
    reflex = reflex_of(s3=0.1, s4=0.1)
    assert reflex.cap(0.1, 0.0) == (0.0, 0.0)
    assert reflex.cap(0.0, 1.0) == (0.0, 0.0), "a corner would turn into it"


def test_what_was_just_heard_stays_although_the_next_sonar_looks_through_its_place() -> None:
    """A wall that is not square enough to the next one gives it no echo."""
    seen = Seen(PROFILE)
    seen.update([echo(0.5, 3)], None, ORIGIN, 0.0)
    sonar, aside = PROFILE.ring.sonars[3], radians(PROFILE.ring.sonars[3].bearing_deg - 14.0)
    place = sonar.x_m + 0.5 * cos(aside), sonar.y_m + 0.5 * sin(aside)  # in the next one's cone

    def nearest() -> float:
        return float(np.hypot(*(seen._echoed[:, :2] - place).T).min())

    for now in (0.1, 0.3):
        seen.update([echo(None, 4)], None, ORIGIN, now)
        assert nearest() < 0.02
    seen.update([echo(None, 4)], None, ORIGIN, 0.6)
    assert nearest() > 0.04
    assert len(seen._echoed) > 0, "the rest of its arc"


def test_what_was_looked_through_from_elsewhere_is_approached_slowly() -> None:
    """A wall may answer from one direction only; but a robot that sees through it need not stop."""
    reflex, heading = Reflex(PROFILE), radians(150.0)
    sonar = PROFILE.ring.sonars[7]  # it looks along 60 degrees
    x = sonar.x_m * cos(heading) - sonar.y_m * sin(heading) + 0.4 * cos(radians(60.0))
    y = sonar.x_m * sin(heading) + sonar.y_m * cos(heading) + 0.4 * sin(radians(60.0))
    for now in (0.0, 0.1):
        reflex.update([echo(0.4, 7)], (0.62 - x, -y, heading), (0.6, 0.0), now)
    reflex.update((), ORIGIN, (0.6, 0.0), 1.9)
    assert reflex.cap(0.6, 0.0)[0] == 0.0
    for now in (2.0, 2.1):
        reflex.update(all_round(), ORIGIN, (0.6, 0.0), now)
    assert 0.0 < reflex.cap(0.6, 0.0)[0] <= CREEP_M_S


def test_between_two_places_that_were_heard_a_wall_goes_on() -> None:
    """Wherever the robot does not fit through: else its rear corner turns into the wall there."""
    seen = Seen(PROFILE)
    for now, x in ((0.0, 0.0), (0.1, 0.25)):
        seen.update([echo(0.15, 0)], None, (x, 0.0, 0.0), now)
    sonar = PROFILE.ring.sonars[0]
    middle = sonar.x_m - 0.125, sonar.y_m + 0.15
    assert np.hypot(*(seen.view(1.0).points - middle).T).min() < 0.05


def test_it_reports_its_caps_at_a_limited_rate() -> None:
    reflex = reflex_of((0.5, 0.0), s3=0.2, s4=0.2)
    assert reflex.complaint(0.0) is None
    reflex.cap(0.5, 0.0)
    assert "1 x slowed" in (reflex.complaint(0.0) or "")
    reflex.cap(0.5, 0.0)
    assert reflex.complaint(0.5 * REPORT_S) is None
    assert reflex.complaint(REPORT_S) is not None
    assert reflex.complaint(inf) is None


def test_a_profile_that_lets_nothing_move_is_refused_with_the_numbers() -> None:
    for slow in ({"v_decel": 0.01}, {"w_decel": 0.01}):
        limits = replace(PROFILE.limits, **slow)
        with pytest.raises(ConfigError, match=r"pioneer-2dx .* rests after .* = 0\.01 "):
            Reflex(replace(PROFILE, limits=limits))


# In the robot agent ------------------------------------------------------------------------------


def test_what_is_obeyed_is_slowed_when_a_reading_comes_though_no_command_does() -> None:
    """The holder may be cut off, and be obeyed until it has been silent for 0.3 s."""
    bench = Bench().connect().cycles(LISTEN + 2)
    free = tuple((index, 4.0) for index in RING)
    for _ in range(2):
        bench.status(echoes=free, left_m_s=0.5, right_m_s=0.5)
    bench.command(0.5, 0.0)
    assert bench.speeds()[-1] == 500
    bench.status(echoes=((3, 0.3), (4, 0.3)), left_m_s=0.5, right_m_s=0.5)
    assert 0 <= bench.speeds()[-1] < 500
    state = bench.status(echoes=((3, 0.3), (4, 0.3)), left_m_s=0.5, right_m_s=0.5)
    assert state.ordered.v == 0.5
    assert state.admitted.v < 0.5
    assert state.capped


def test_without_the_reflex_a_command_passes_as_it_is() -> None:
    bench = Bench(reflex=False).connect().cycles(LISTEN + 2)
    bench.status(echoes=((3, 0.3),))
    bench.command(0.9, 0.2)
    assert bench.speeds()[-1] == 900
    assert bench.sent(Cmd.RVEL)


# With a laser -------------------------------------------------------------------------------------


def jackal(rays: int) -> RobotProfile:
    pytest.importorskip("armadico.bridge.ros2")
    profile = load_profile("jackal")
    assert profile.laser is not None
    return replace(profile, laser=replace(profile.laser, rays=rays))


def scan_of(ranges: list[float], number: int, around: float = tau) -> Scan:
    step = around / len(ranges)
    at = 0.12, 0.0, 0.0
    return message_of(
        Cycle(1, number), ranges, (-0.5 * around, step), (0.1, 30.0), at, number=number
    )


def sees(profile: RobotProfile, ranges: list[float], v: float, around: float = tau) -> float:
    """The speed let through of one ordered and driven."""
    reflex = Reflex(profile)
    for number in (1, 2):
        scan = scan_of(ranges, number, around)
        reflex.update((), ORIGIN, (v, 0.0), 0.1 * number, scan)
    return reflex.cap(v, 0.0)[0]


def test_a_laser_that_sees_far_lets_it_drive_and_what_it_sees_ahead_stops_it() -> None:
    profile = jackal(720)
    assert sees(profile, [10.0] * 720, 1.0) == 1.0
    ahead = [0.5 if abs(index - 360) < 40 else 10.0 for index in range(720)]
    assert sees(profile, ahead, 1.0) < 1.0
    half = [10.0] * 360
    assert sees(profile, half, 0.8, tau / 2) == 0.8
    assert abs(sees(profile, half, -0.8, tau / 2)) <= CREEP_M_S, "it does not look back"


@given(st.integers(7, 60))
def test_fewer_rays_show_less(rays: int) -> None:
    """Between two rays an object may stand from some distance on."""
    speeds = [sees(jackal(each), [10.0] * each, 1.0) for each in (rays, 2 * rays, 720)]
    assert speeds == sorted(speeds)
    width = SHARE * jackal(rays).body.width_m
    if met_within(tau / rays, width) < 0.5:
        assert speeds[0] < 1.0


def among(walls: np.ndarray, x: float, number: int, around: float) -> Scan:
    """A scan of a robot at (x, 0) among walls, (n, 4): both ends, m."""
    bearings = (np.arange(720) / 720 - 0.5) * around
    ex, ey = walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1]
    ax, ay = walls[:, 0] - x - 0.12, walls[:, 1]
    c, s = np.cos(bearings)[:, None], np.sin(bearings)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        away = (ax * ey - ay * ex) / (c * ey - s * ex)
        along = (ax * s - ay * c) / (c * ey - s * ex)
    hit = (away > 0.0) & (along >= 0.0) & (along <= 1.0)
    ranges = np.where(hit, away, 20.0).min(axis=1, initial=20.0)
    return scan_of(ranges.tolist(), number, around)


def test_a_wall_that_leaves_the_view_of_a_laser_goes_on() -> None:
    """Behind the robot no ray looks, and the wall that it sees aside crosses its way there."""
    profile = jackal(720)
    reflex, x, v = Reflex(profile), 0.0, 0.0
    wall = np.array([[-1.0, 0.0, 0.0, -1.0]])
    corner = profile.body.rear_m + profile.body.width_m / 2
    for number in range(1, 60):
        scan = among(wall, x, number, radians(270))
        reflex.update((), (x, 0.0, 0.0), (v, 0.0), 0.1 * number, scan, (v, 0.0))
        v = reflex.cap(-CREEP_M_S, 0.0)[0]
        x += 0.1 * v
    assert -1.0 + corner < x < -0.1, "it came nearer, and did not touch"


def test_a_thin_object_stays_between_two_scans_that_show_it() -> None:
    profile = jackal(720)
    post = [0.5 if abs(index - 360) < 2 else 10.0 for index in range(720)]
    reflex = Reflex(profile)
    speeds = []
    for number in range(1, 9):
        scan = scan_of(post if number < 3 else [10.0] * 720, number)
        reflex.update((), ORIGIN, (1.0, 0.0), 0.1 * number, scan)
        speeds.append(reflex.cap(1.0, 0.0)[0])
    assert max(speeds[1:5]) < 1.0
    assert speeds[-1] == 1.0, "it is gone"


def test_the_end_of_a_wall_that_a_laser_looks_along_stays_until_a_scan_would_show_it() -> None:
    profile = jackal(720)
    seen, known = Seen(profile), []
    wall, nothing = np.array([[0.6, 0.0, 2.0, 0.0]]), np.empty((0, 4))
    places = [(-0.4, wall)] * 2 + [(0.0, nothing)] * 8 + [(-0.4, nothing)] * 8
    for number, (y, walls) in enumerate(places, 1):
        scan = among(walls - (0.0, y, 0.0, y), 0.0, number, tau)
        seen.update((), scan, (0.0, y, 0.0), 0.1 * number)
        at = seen.view(1.0).points
        known.append(bool((np.hypot(at[:, 0] - 0.6, at[:, 1] + y) < 0.03).any()))
    assert all(known[:10]), "its rays pass the end on both sides"
    assert not known[-1], "it is gone"


def test_a_door_that_was_opened_while_a_laser_looked_along_it_is_forgotten() -> None:
    """It is so near that points there do not age, and the robot stands: no ray need meet it."""
    seen, known = Seen(jackal(720)), []
    leaf, nothing = np.array([[0.5, 0.0, 1.3, 0.0]]), np.empty((0, 4))
    for number in range(1, 150):
        y = -0.6 if number < 3 else 0.0
        walls = leaf if number < 6 else nothing
        scan = among(walls - (0.0, y, 0.0, y), 0.0, number, tau)
        seen.update((), scan, (0.0, y, 0.0), 0.1 * number)
        at = seen.view(1.0).points
        known.append(bool((np.hypot(at[:, 0] - 0.5, at[:, 1] + y) < 0.03).any()))
    assert known[6], "a ray need not meet it"
    assert not known[-1]


def test_a_leg_that_walks_away_from_a_laser_leaves_nothing_behind() -> None:
    """Its places are a row along the ray, as a wall's are, but each from another scan."""
    seen, left = Seen(jackal(720)), []
    for number in range(1, 30):
        x = 0.5 + 0.08 * number
        leg = np.array([[x, -0.03, x, 0.03]])
        seen.update((), among(leg, 0.0, number, tau), ORIGIN, 0.1 * number)
        at = seen.view(3.0).points
        left.append(int((at[:, 0] < x - 0.5).sum()))
    assert max(left) == 0


def test_what_came_nearer_than_the_least_range_of_a_laser_stays_until_it_is_farther() -> None:
    """No scan can show it there again, and rays that pass an edge or are lost do not refute it."""
    pytest.importorskip("armadico.bridge.ros2")
    seen = Seen(load_profile("turtlebot3-burger"))
    post = [0.2 if abs(index - 180) < 2 else 3.0 for index in range(360)]
    known = []
    for number, x in enumerate([0.0, 0.07, 0.07, 0.0, 0.0], 1):
        ranges = post if number == 1 else [3.0] * 360
        scan = replace(scan_of(ranges, number), x=-0.032)
        seen.update((), scan, (x, 0.0, 0.0), 0.6 * number)
        at = seen.view(0.3).points
        known.append(bool((np.hypot(at[:, 0] - (0.168 - x), at[:, 1]) < 0.02).any()))
    assert known == [True, True, True, False, False]


def test_standing_within_the_least_range_of_a_laser_it_notes_no_more_and_more() -> None:
    pytest.importorskip("armadico.bridge.ros2")
    seen, rng, noted = Seen(load_profile("turtlebot3-burger")), np.random.default_rng(1), []
    for number in range(1, 201):
        ranges = 0.17 + 0.01 * rng.standard_normal(360)
        ranges[ranges < 0.16] = np.nan
        ranges[rng.random(360) < 0.3] = 3.0
        scan = replace(scan_of(ranges.tolist(), number), x=-0.032)
        seen.update((), scan, ORIGIN, 0.2 * number)
        noted.append(len(seen.view(0.3).points))
    assert max(noted[100:]) < 1.5 * max(noted[10:100])


def test_what_was_just_commanded_counts_though_the_wheels_do_not_show_it_yet() -> None:
    speeds = []
    for driven in ((0.0, 0.0), (1.0, 0.0)):
        reflex = Reflex(jackal(720))
        ahead = [0.4 if abs(index - 360) < 40 else 10.0 for index in range(720)]
        for number in (1, 2, 3):
            scan = scan_of(ahead, number)
            reflex.update((), ORIGIN, (0.0, 0.0), 0.1 * number, scan, driven)
        speeds.append(reflex.cap(2.0, 0.0)[0])
    assert speeds[1] < speeds[0]


@pytest.mark.parametrize("away", [0.116, 0.128, 0.14, 0.156])
def test_what_it_admits_in_one_cycle_it_goes_on_admitting(away: float) -> None:
    """Of a robot that is held; else it would be ordered on and back by turns, and creep."""
    reflex, driven, admitted = Reflex(PROFILE), (0.0, 0.0), []
    for number in range(16):
        reflex.update(all_round(s3=away, s4=away), ORIGIN, (0.0, 0.0), 0.1 * number, driven=driven)
        driven = reflex.cap(0.3, 0.0)
        admitted.append(driven[0])
    assert max(admitted[5:]) - min(admitted[5:]) < 0.02


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_person_who_comes_nearer_is_expected_to_come_on(side: float) -> None:
    """And what has left the view may be behind the robot by now."""
    speeds = []
    for pace in (0.0, 1.2):
        reflex = Reflex(jackal(720))
        for number in range(1, 8):
            x = 1.6 + pace * 0.1 * (7 - number)
            person = np.array([[x, 0.1 * side, x, 0.6 * side], [x, 0.1 * side, 9.0, 0.1 * side]])
            scan = among(person, 0.0, number, tau)
            reflex.update((), ORIGIN, (1.0, 0.0), 0.1 * number, scan, (1.0, 0.0))
        speeds.append(reflex.cap(1.0, 0.0)[0])
    assert speeds[0] == 1.0
    assert speeds[1] < 1.0


def test_a_laser_that_sees_its_own_robot_does_not_hold_it() -> None:
    seen = Seen(jackal(360))
    seen.update((), scan_of([0.11] * 360, 1), ORIGIN, 0.1)
    own = np.abs(seen.view(1.0).points) < 0.1
    assert not own.all(axis=1).any()


@pytest.mark.parametrize(
    ("ranges", "after_s", "stays"),
    [(10.0, 1.0, True), (10.0, KEPT_S + 1.0, False), (0.3, KEPT_S + 1.0, True)],
)
def test_a_near_echo_that_a_laser_looks_through_is_forgotten_after_a_while(
    ranges: float, after_s: float, stays: bool
) -> None:
    """A pane, at once: no. What no sonar looks at any more must not hold a robot for good."""
    laser = jackal(720).laser
    seen = Seen(replace(load_profile("jackal-sonars"), laser=laser))
    seen.update([Echo(0.2, 0.0, 0.0, 0.3)], None, ORIGIN, 0.0)
    seen.update([], scan_of([ranges] * 720, 1), ORIGIN, after_s)
    at = seen.view(1.0).points
    assert bool((np.hypot(at[:, 0] - 0.5, at[:, 1]) < 0.02).any()) is stays


def test_a_silent_sonar_shows_no_more_than_a_slanted_wall_would_let_it() -> None:
    seen = Seen(PROFILE)
    seen.update(all_round(), None, ORIGIN, 0.0)
    ahead = [x for x, y in seen.view(2.0).unseen if abs(y) < 0.1 and x > 0.0]
    assert min(ahead) == pytest.approx(PROFILE.ring.sonars[3].x_m + HEARD_M, abs=0.15)
