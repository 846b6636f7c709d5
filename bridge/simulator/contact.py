"""Contacts between walls and the robot's body.

pymunk finds contacts between the walls and the footprint, a rectangle with a skin of `SKIN_M`, so
they are known with their gaps before they happen. They are solved here in the robot's coordinates:
a free body would slide sideways where tyres hold, and the motors' inertia is in J only. Contacts
are rigid, without bounce and friction.

The tyres hold sideways up to `GRIP` times the weight on them (the caster carries the rest, and
rolls). So a robot along a wall can turn away from it if its motors push hard. If tyres never
slipped, it could not.
"""

from __future__ import annotations

from typing import NamedTuple

import pymunk

from armadico.bridge.simulator.walls import Arm, Box, Other, Walls
from armadico.config.profile import RobotProfile

SKIN_M = 0.05  # contacts are detected from here; no step at less than 10 m/s jumps over it
GRIP = 0.5  # of rubber on an office floor: sideways force over weight
GRAVITY = 9.81  # m/s^2
SWEEPS = 50
SETTLED_N = 1e-4  # smaller changes of force end the iteration


class Contact(NamedTuple):
    """A place where footprint and wall are close, as the speed that closes its gap.

    The gap shrinks at `v` * v + `u` * u + `w` * w (u: m/s to the left), less the speed of another
    robot in that direction, if the contact is with one.
    """

    v: float
    u: float
    w: float  # m
    gap: float  # m, negative inside the wall
    other: Other | None = None
    arm: Arm | None = None  # the other robot's


class Motion(NamedTuple):
    """Speeds ahead and to the left (m/s) and turn rate (rad/s)."""

    v: float
    u: float
    w: float


def box_of(profile: RobotProfile) -> Box:
    """The footprint of a robot."""
    body = profile.body
    length = body.front_m + body.rear_m
    return Box(0.5 * (body.front_m - body.rear_m), 0.5 * length, 0.5 * body.width_m)


class Outline:
    """The robot's footprint among the walls, and its mass with wheels."""

    def __init__(self, profile: RobotProfile, walls: Walls) -> None:
        body = profile.body
        front, rear, side = body.front_m, -body.rear_m, 0.5 * body.width_m
        corners = [(rear, -side), (front, -side), (front, side), (rear, side)]
        self._walls, self._space = walls, walls.space
        self._body = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        self._shape = pymunk.Poly(self._body, corners, radius=SKIN_M)
        inertia, caster = profile.inertia, profile.caster
        self.mass_kg, carried = body.mass_kg, 0.0  # carried by a caster, which rolls sideways
        if inertia is not None and caster is not None:
            self.mass_kg += 2.0 * inertia.wheel_mass_kg + caster.mass_kg
            behind = max(0.0, -inertia.mass_centre_x_m) / (caster.arm_m + caster.trail_m)
            carried = behind * body.mass_kg
        self._grip_n = GRIP * GRAVITY * (self.mass_kg - carried)

    def contacts(self, pose: tuple[float, float, float]) -> list[Contact]:
        """Every wall within `SKIN_M` of the footprint at a pose."""
        x, y, theta = pose
        self._body.position = (x, y)
        self._body.angle = theta
        ahead_x, ahead_y = self._body.rotation_vector
        found = []
        others = self._walls.others
        for hit in self._space.shape_query(self._shape):
            nx, ny = hit.contact_point_set.normal  # from the robot to the wall
            other = others.get(hit.shape) if others else None
            for point in hit.contact_point_set.points:
                (ax, ay), (bx, by) = point.point_a, point.point_b
                gap = SKIN_M - (nx * (ax - bx) + ny * (ay - by))
                lever = (bx - x) * ny - (by - y) * nx
                along, aside = nx * ahead_x + ny * ahead_y, ny * ahead_x - nx * ahead_y
                arm = None if other is None else other.arm(bx, by, nx, ny)
                found.append(Contact(along, aside, lever, gap, other, arm))
        return found

    def resolve(
        self,
        contacts: list[Contact],
        motion: Motion,
        mobility: tuple[float, float, float],
        dt: float,
    ) -> tuple[Motion, float]:
        """Speeds that close no gap within `dt` (s), and the greatest force needed, N."""
        v, u, w = motion
        i00, i01, i11 = mobility
        iu = dt / self.mass_kg
        rows = [_row(contact, mobility, iu, dt) for contact in contacts]
        forces = [0.0] * len(rows)
        grip, most = 0.0, self._grip_n
        for _ in range(SWEEPS):
            held = max(-most, min(most, grip - u / iu))
            u += iu * (held - grip)
            change, grip = abs(held - grip), held
            for k, (nv, nu, nw, most_speed, compliance) in enumerate(rows):
                excess = nv * v + nu * u + nw * w - most_speed
                other, arm = contacts[k].other, contacts[k].arm
                if other is not None and arm is not None:
                    excess -= other.speed_of(arm)
                force = max(0.0, forces[k] + excess / compliance)
                step = force - forces[k]
                forces[k] = force
                if other is not None and arm is not None:
                    other.push(arm, step)
                v -= step * (i00 * nv + i01 * nw)
                u -= step * iu * nu
                w -= step * (i01 * nv + i11 * nw)
                change = max(change, abs(step))
            if change < SETTLED_N:
                break
        return Motion(v, u, w), max(forces, default=0.0)


def _row(
    contact: Contact, mobility: tuple[float, float, float], iu: float, dt: float
) -> tuple[float, float, float, float, float]:
    """The contact's direction, the speed that closes its gap in `dt`, and its compliance."""
    v, u, w, gap, other, arm = contact
    i00, i01, i11 = mobility
    compliance = i00 * v * v + 2.0 * i01 * v * w + i11 * w * w + iu * u * u
    if other is not None and arm is not None:
        compliance += other.compliance_of(arm)
    return v, u, w, max(0.0, gap) / dt, compliance
