"""Parameters of the methods, which a file or ``--set KEY=VALUE`` may change."""

from __future__ import annotations

from math import cos, radians, tan
from typing import Literal

from msgspec import Struct


class NearSettings(Struct, frozen=True):
    """Memory and queries of a local map, for any sensor."""

    reach_m: float  # greatest distance of points
    memory: float = 0.995  # share left per cycle: a certain point lasts 24 s at rest
    memory_off_map: float = 0.985  # share left of unmapped points (8 s): mostly people
    memory_m: float = 1.5  # distance driven that halves a probability: a certain point lasts 2.6 m
    frontal_rad: float = radians(40)  # bearings up to this are in front
    abeam_rad: float = radians(120)  # bearings from there to this are beside


class MapSettings(NearSettings, frozen=True):
    """How the sonars' local map gains and loses probability, which is not calibrated."""

    reach_m: float = 2.5  # radius of the outermost ring
    hit: float = 0.6  # added at an echo
    miss: float = 0.35  # subtracted where an echo from farther away passed through
    silence: float = 0.15  # subtracted by a ping without an echo
    miss_facing: float = cos(radians(45))  # a miss counts within this of the direction of the hit
    silence_facing: float = cos(radians(20))  # silence counts within this of the hit's direction
    axis_rad: float = radians(10)  # a point within this of a sonar's axis must answer
    threshold: float = 0.3  # least probability of an occupied cell
    seen_by: Literal["axis", "cells"] = "axis"  # a ping clears points near its axis, or cells
    seen_decay: float = 0.93  # with "cells": share left per cycle where a sonar looks
    seen_threshold: float = 0.5  # with "cells": least probability of an occupied cell there
    forget: float = 0.05  # a cell below this is dropped
    margin_m: float = 0.1  # an echo clears points more than this before it
    apart_m: float = 0.06  # points of a near cell farther apart than this are two
    goes_on: bool = True  # extrapolate walls from points in a row


class ScanSettings(NearSettings, frozen=True):
    """What a laser's local map keeps of a scan, and how long points out of sight last."""

    reach_m: float = 4.0  # greatest distance of points: beyond, no behaviour brakes yet
    sector_rad: float = radians(2.0)  # the nearest ray in each sector is kept
    jump_m: float = 0.12  # difference in range of an edge, of which the nearer point is kept
    jump: float = 0.08  # share of the range that is added to that difference
    apart_m: float = 0.04  # one point is kept of those closer than this
    margin_m: float = 0.08  # a ray longer by this passed through a point
    silence: float = 0.1  # subtracted by a ray without a return: dark surfaces, glass
    forget: float = 0.3  # a point below this is dropped
    most: int = 400  # points, the nearest of those remembered


class WallSettings(Struct, frozen=True):
    """How walls of the global map count in the local one, and what makes them doubted."""

    reach_m: float = 1.5  # greatest distance of wall points; 0: the map is not used
    sure_m: float = 0.3  # greatest standard deviation of a pose that places them
    kept_s: float = 30.0  # time for which odometry extends such a pose
    grows: float = 0.01  # growth of its variance per metre, m^2
    unknown_m: float = 0.5  # standard deviation of the pose at which walls have no weight
    least: float = 0.3  # least weight of a wall that counts
    axis: float = tan(radians(10))  # greatest angle off a sonar's axis at which a point must answer
    square: float = cos(radians(20))  # greatest angle of incidence at which it must answer
    margin_m: float = 0.2  # an echo from farther behind a point than this adds doubt
    miss: float = 0.4  # doubt added by such an echo
    memory: float = 0.997  # share of a doubt left per cycle: half after 23 s
    explains_m: float = 2.5  # greatest distance of points that explain echoes
    explains_near_m: float = 0.1  # greatest difference in range, plus the pose's deviation
    explains_cone: float = cos(radians(34))  # greatest angle off the axis of a smooth wall
    explains_beam: float = cos(radians(15))  # greatest angle off the axis of a rough wall


class Brisk(Struct, frozen=True, forbid_unknown_fields=True):
    """Goto's `brisk` controller; SI units."""

    v: float = 0.75  # greatest speed
    v_decel: float = 0.55  # deceleration that it plans with
    w: float = radians(90)
    w_decel: float = 1.3
    park_decel: float = 1.6  # for a turn on the spot at the goal, which need not settle on a line
    w_accel: float = 1.7
    w_jerk: float = 6.0
    settle_s: float = 0.2  # time in which the turn rate follows its set-point, within those limits
    late_s: float = 0.25  # delay of the wheels
    turn_s: float = 0.25  # delay of the end of a turn
    look_m: float = 0.4  # look-ahead distance on the line
    look_s: float = 0.35  # look-ahead time: this times the speed is added
    cut_m: float = 0.1  # by how much corners may be cut near obstacles
    calm_from: float = radians(10)  # it slows down from this angle to its target
    calm_over: float = radians(60)  # to a stop at this angle more
    corner_w: float = 1.25  # greatest turn rate in a corner
    corner_m: float = 0.5  # distance before a corner at which its arc begins
    corner_v: float = 0.2
    on_line_m: float = 0.05  # within this of the last leg's line it keeps its direction
    turn_m: float = 0.3  # within this of the goal it turns to the goal's heading while braking
    short_m: float = 0.02  # distance before the goal at which it stops
    beside_m: float = 0.10  # distance to a goal that is abeam at which it stops
    leave_m: float = 0.115  # it drives again only beyond this
    stop_rad: float = radians(1.5)
    sight_m: float | None = None  # the sensors' range; it can stop within the visible path
