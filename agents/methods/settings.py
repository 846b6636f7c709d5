"""What of the methods a file or ``--set KEY=VALUE`` may change, within the agents' parameters."""

from __future__ import annotations

from math import cos, radians, tan
from typing import Literal

from msgspec import Struct


class NearSettings(Struct, frozen=True):
    """What a local map remembers and what is asked of it, whatever the sensor."""

    reach_m: float  # what is farther is not near
    memory: float = 0.995  # a cycle: what is certain lasts 24 s at rest,
    memory_off_map: float = 0.985  # and 8 s where it is not on the map: mostly people, who go on
    memory_m: float = 1.5  # the way that halves a belief: the same lasts 2.6 m
    frontal_rad: float = radians(40)  # in front: within this of the heading
    abeam_rad: float = radians(120)  # beside: between that and this


class MapSettings(NearSettings, frozen=True):
    """How the sonars' local map believes and forgets. Probabilities are shares, not calibrated."""

    reach_m: float = 2.5  # of the outermost ring
    hit: float = 0.6  # added where an echo comes from
    miss: float = 0.35  # taken where an echo from farther away went through
    silence: float = 0.15  # taken where a ping brought nothing back at all
    miss_facing: float = cos(radians(45))  # by a sonar that looks the way it was heard, so nearly,
    silence_facing: float = cos(radians(20))  # or so: a smooth wall at a slant does not answer
    axis_rad: float = radians(10)  # a point within this of a sonar's axis had to echo
    threshold: float = 0.3  # occupied from here on
    seen_by: Literal["axis", "cells"] = "axis"  # a ping doubts near its axis, or by cells: 3.4.2
    seen_decay: float = 0.93  # by cells: a cycle, where a sonar looks,
    seen_threshold: float = 0.5  # and occupied there
    forget: float = 0.05  # a cell below this is dropped
    margin_m: float = 0.1  # an echo clears what lies this much before it
    apart_m: float = 0.06  # points of a near cell farther apart than this are two
    goes_on: bool = True  # points in a row are a wall that goes on


class ScanSettings(NearSettings, frozen=True):
    """What a laser's local map keeps of a scan, and for how long of what is out of sight."""

    reach_m: float = 4.0  # what is farther nobody brakes for yet
    sector_rad: float = radians(2.0)  # of the rays in each the nearest is kept,
    jump_m: float = 0.12  # and the nearer of two neighbours whose ranges differ so much,
    jump: float = 0.08  # and by this share of the range more: an edge
    apart_m: float = 0.04  # of what is nearer to each other one will do
    margin_m: float = 0.08  # a ray that went so much farther than a point went through it
    silence: float = 0.1  # of belief that a ray takes which found nothing: dark things, and glass
    forget: float = 0.3  # what is believed less is no more
    most: int = 400  # points, of those remembered the nearest


class WallSettings(Struct, frozen=True):
    """How far the walls of the global map count in the local one, and what makes them doubted."""

    reach_m: float = 1.5  # places of walls within this; 0: the map is not used
    sure_m: float = 0.3  # a pose no more uncertain than this says where they are,
    kept_s: float = 30.0  # and the wheels for so long after it,
    grows: float = 0.01  # m^2 of variance more a metre
    unknown_m: float = 0.5  # with a pose so uncertain they count for nothing,
    least: float = 0.3  # and not at all with less than this share of belief
    axis: float = tan(radians(10))  # a place within this of a sonar's axis,
    square: float = cos(radians(20))  # of a wall that the axis meets so squarely, had to echo
    margin_m: float = 0.2  # an echo from so much behind it
    miss: float = 0.4  # adds so much doubt,
    memory: float = 0.997  # of which so much is left a cycle: half after 23 s
    explains_m: float = 2.5  # places within this explain echoes: as far as the local map reaches
    explains_near_m: float = 0.1  # that come from so nearly as far, and the pose's deviation more,
    explains_cone: float = cos(radians(34))  # off the axis by no more: smooth walls answer there
    explains_beam: float = cos(radians(15))  # and rough ones, at a slant, from no farther off it


class Brisk(Struct, frozen=True, forbid_unknown_fields=True):
    """Goto's controller `brisk`; SI."""

    v: float = 0.75  # at most
    v_decel: float = 0.55  # that it counts on
    w: float = radians(90)
    w_decel: float = 1.3
    park_decel: float = 1.6  # of a turn on the spot at the goal, which need not settle on a line
    w_accel: float = 1.7
    w_jerk: float = 6.0
    settle_s: float = 0.2  # in which the turn rate follows what is wanted, within those
    late_s: float = 0.25  # the wheels follow so late
    turn_s: float = 0.25  # how late a turn is stopped
    look_m: float = 0.4  # it steers to the line so far ahead,
    look_s: float = 0.35  # and by the way of so long more
    cut_m: float = 0.1  # corners of the line may be cut by so much where something is near
    calm_from: float = radians(10)  # turning by more than this, it slows down,
    calm_over: float = radians(60)  # by so much more to nothing
    corner_w: float = 1.25  # a corner is taken at no more than this turn rate
    corner_m: float = 0.5  # on an arc that begins so far before it
    corner_v: float = 0.2
    on_line_m: float = 0.05  # so near to the last leg's line it keeps its direction to the goal
    turn_m: float = 0.3  # so near to the goal it turns to the goal's heading while it brakes,
    short_m: float = 0.02  # and comes to rest so far before it
    beside_m: float = 0.10  # or than this with the goal abeam,
    leave_m: float = 0.115  # and drives again only beyond this
    stop_rad: float = radians(1.5)
    sight_m: float | None = None  # so far it sees, and stops within what it sees of its way
