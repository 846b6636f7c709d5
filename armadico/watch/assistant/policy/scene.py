"""Where the robot is and what is near, against the rules of a client. Sans-IO."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, hypot, inf, sin
from typing import Final

from armadico.core.messages import Description, RobotState
from armadico.mobile.behaviour import LOST_M
from armadico.mobile.geometry import to_world
from armadico.mobile.messages import NO_POSE, Pose
from armadico.mobile.obstacles import Obstacles
from armadico.watch.assistant.policy.area import Place
from armadico.watch.assistant.policy.policy import SPARE_M, Rules

LAG_S: Final = 0.4
"""From a pose until the robot brakes for it, s: a cycle to decide, one until no agent drives, and
the controller's delay."""

SEEN_S: Final = 0.3
"""The time in which three messages of obstacles arrive, s."""

NO_OBSTACLES: Final = "what is near the robot is not known: no fresh obstacles"

BEYOND_M: Final = 0.05
"""So far beyond the end of its path a robot may still come."""


@dataclass(frozen=True)
class Scene:
    """What is known of the robot now."""

    body: Description | None  # its footprint and limits; None: not received
    pose: Pose | None  # none: there is no fresh one
    state: RobotState | None  # its speeds; None: there is no fresh one
    obstacles: Obstacles | None  # none: there are no fresh ones
    to_go_m: float = inf  # what remains of its path, m; inf: that is not known

    @property
    def here(self) -> Place:
        assert self.pose is not None, "checked by `unknown`"
        return self.pose.x, self.pose.y

    @property
    def unknown(self) -> str:
        """What has to be known to judge a path, and is not; "" if all is."""
        if self.body is None:
            return "the robot's size is not known: no robot/description"
        if self.pose is None:
            return NO_POSE
        if self.pose.deviation > LOST_M or not self.pose.covariance:
            return "where the robot is is not known well enough for the policy"
        return ""

    def lacks(self, rules: Rules) -> str:
        """What has to be known to judge a goal by these rules, and is not; "" if all is."""
        if not rules.needs_path:
            return ""
        near = rules.section.people_m is None or self.obstacles is not None
        return self.unknown or ("" if near else NO_OBSTACLES)

    def refusal(
        self, rules: Rules, path: Sequence[Place], what: str = "the path", *, legs: bool = True
    ) -> str:
        """Why a path from here is refused; "" if it is not.

        The path, with the name `what`, leads over places (m), without the robot's. `legs`: it is
        straight from here to them; they alone count otherwise.
        """
        if not rules.needs_path:
            return ""
        if why := self.lacks(rules):
            return why
        whole = [self.here, *path]
        return (
            rules.outside([self.here], self._least, "the robot")
            or rules.outside(path, self._least + SPARE_M, what)
            or (rules.outside(whole, self._least, what) if legs else "")
            or self._too_near(rules, whole if legs else path, drives=legs)
        )

    def strays(self, rules: Rules, path: Sequence[Place]) -> str:
        """Why a path under way leaves the area; "" if it does not."""
        if rules.area.everywhere:
            return ""
        return self.unknown or rules.outside([self.here, *path], self._least)

    def rooms_to_ask(self, rules: Rules, path: Sequence[Place]) -> tuple[str, ...]:
        """The rooms on the way from here over these places that need approval."""
        assert self.body is not None, "checked by `unknown`"
        return rules.rooms_to_ask([self.here, *path], self.body.half_width)

    def left(self, rules: Rules) -> str:
        """Why a robot under way has left the area, or is about to; "" if it has not.

        About to: if it is told to brake now, it comes to rest outside.
        """
        if rules.area.everywhere:
            return ""
        if self.unknown:
            return self.unknown
        return rules.outside([self.here], self._least, "the robot") or rules.outside(
            [self._rests_at()], self._least, "where the robot can stop"
        )

    def crowded(self, rules: Rules) -> str:
        """Why the robot is too near to what may be a person; "" if it is not."""
        if rules.section.people_m is None:
            return ""
        if self.unknown:
            return self.unknown
        if self.obstacles is None:
            return NO_OBSTACLES
        return self._too_near(rules, [self.here, self._rests_at(LAG_S + SEEN_S)], drives=True)

    @property
    def _least(self) -> float:
        """The distance of the robot's middle from the border, m, with the doubt of its pose."""
        assert self.body is not None, "checked by `unknown`"
        assert self.pose is not None, "checked by `unknown`"
        return self.body.half_width + self.pose.deviation

    def _too_near(self, rules: Rules, path: Sequence[Place], *, drives: bool) -> str:
        pose, body, obstacles = self.pose, self.body, self.obstacles
        if rules.section.people_m is None or pose is None or body is None:
            return ""
        if obstacles is None:
            return NO_OBSTACLES
        points = [to_world((pose.x, pose.y, pose.theta), p.x, p.y) for p in obstacles.points]
        radius = hypot(max(body.front, body.rear), body.half_width)
        here = self.here if drives else None
        return rules.too_near(path, rules.strangers(points), radius, here)

    def _rests_at(self, lag_s: float = LAG_S) -> Place:
        """Where its front comes to rest if it is told to brake now, on its present arc."""
        pose, body, state = self.pose, self.body, self.state
        assert pose is not None, "checked by `unknown`"
        assert body is not None, "checked by `unknown`"
        v, w = (0.0, 0.0) if state is None else (state.v, state.w)
        length = abs(v) * lag_s + v * v / (2.0 * body.v_decel)
        length = min(length, max(self.to_go_m, 0.0) + BEYOND_M)
        turn = w / abs(v) * length if abs(v) > 1e-3 else 0.0
        edge = (body.front if v >= 0.0 else body.rear) - body.half_width
        heading = pose.theta + turn / 2
        length = length + max(edge, 0.0) if abs(v) > 1e-3 else 0.0
        sign = 1.0 if v >= 0.0 else -1.0
        return pose.x + sign * length * cos(heading), pose.y + sign * length * sin(heading)
