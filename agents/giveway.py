"""The giveway agent: of two robots that stand head on in a narrow place, has one back off."""

from __future__ import annotations

from math import atan2, dist, hypot, inf, radians
from typing import Annotated, Any, ClassVar, Final

from msgspec import Meta

from armadico.agents.methods.geometry import clip
from armadico.agents.methods.known_robots import KnownRobots
from armadico.core import agent
from armadico.core.behaviour import Behaviour
from armadico.core.exchange import Bid
from armadico.core.geometry import Pose2, relative, wrap
from armadico.core.messages import FleetMeeting, FleetPose, Message, Obstacles, Pose, RobotState
from armadico.core.parameters import Safety

Metres = Annotated[float, Meta(gt=0, le=100)]
Seconds = Annotated[float, Meta(gt=0, le=600)]

STEP_M: Final = 0.1
"""From one place of the trail to the next."""

TRAIL: Final = 80
"""Places that it remembers."""

JUMP_M: Final = 0.5
"""A pose so far from the last place is elsewhere: the trail does not lead there."""

AIM_M: Final = 0.35
"""It backs towards the place of the trail that is so far off."""

AHEAD_RAD: Final = radians(75)
"""Each is within this of where the other heads: they meet."""

PASSED_RAD: Final = radians(100)
"""And beyond this they have passed."""

HEARD_S: Final = 1.0
"""So long another's word on a meeting counts."""

NEAR_M: Final = 0.01
"""Nobody's middle is nearer, whatever it says."""

ROBOT_M: Final = 0.5
"""What is so near to the other's middle is that robot."""

HALF_M: Final = 10.0
"""With so far to go half of all there is to have is worth it to drive on."""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """When two robots have met, and how one of them backs off."""

    namespace: Annotated[str, Meta(min_length=1)] = "robot1"
    v: Annotated[float, Meta(gt=0, le=1)] = 0.2  # m/s, backwards
    v_max: Annotated[float, Meta(gt=0, le=10)] | None = None  # a scenario's limit
    w_most: Annotated[float, Meta(gt=0, le=2)] = 0.5  # rad/s
    near_m: Metres = 2.5  # from middle to middle: nearer they have met where it is narrow:
    narrow_m: Metres = 0.75  # with less beside it to the left and to the right;
    stands_m: Metres = 1.3  # or where they are so near
    still_m_s: Annotated[float, Meta(gt=0, le=1)] = 0.05  # and no faster
    stood_s: Seconds = 2.0  # for so long
    back_m: Metres = 1.2  # it backs off so far at least: whoever comes through a door turns there
    beside_m: Metres = 0.6  # and to where so much is free on one side of it
    held_s: Seconds = 6.0  # who gets no farther back for so long cannot
    cannot_s: Seconds = 20.0  # and says so for this time
    apart_m: Metres = 3.5  # so far apart they are done with each other;
    most_s: Seconds = 60.0  # or after so long
    utility: Annotated[float, Meta(gt=0, le=1)] = 0.95
    safety: Safety = Safety(slow=0.2)


class GiveWay(Behaviour):
    """Contends for the wheels while the robot gives way to another one of its fleet.

    Two that stand face to face, each with a way to go, have met. Both say what it is worth to drive
    on (`fleet/<robot>/meeting`): the more, the farther there is to go, and all there is for who
    cannot back off. Who says less backs off along its own trail, to where there is room beside it,
    and stands until the other has passed. Who says more does nothing: its other agents drive on.
    """

    name = "giveway"
    reacts_to = Obstacles
    hears: ClassVar[tuple[type[Message], ...]] = (*Behaviour.hears, FleetPose, FleetMeeting)
    provides: ClassVar[tuple[type[Message], ...]] = (FleetMeeting,)
    parameters = Parameters
    launched_with = ("v_max", "namespace")
    changeable: ClassVar = {
        "v": "m/s",
        "v_max": "m/s",
        "stood_s": "s",
    }
    needs_goal: ClassVar[bool] = False  # a way that waits is one, too: it looks for itself
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self.robot = self.p.namespace.rpartition("/")[2]
        self._robots = KnownRobots(self.robot)
        self._said: dict[str, tuple[FleetMeeting, float]] = {}
        self._trail: list[tuple[float, float]] = []
        self._here: tuple[float, float] | None = None
        self._met = ""  # another robot, that is head on
        self._stood_since = 0.0  # s: before that
        self._yields_since: float | None = None
        self._back_off = True  # or is there, and waits
        self._met_at = (0.0, 0.0)
        self._got_on_at = 0.0  # s: when it last got on backwards
        self._cannot_until = -inf

    def key_of(self, kind: type[Message], **names: str) -> str:
        """Of what robots share each has a key of its own."""
        return super().key_of(kind, robot=self.robot, **names)

    # What it hears --------------------------------------------------------------------------------

    def on_fleet_pose(self, said: FleetPose) -> None:
        """Where another robot is."""
        self._robots.hear(said, self.now)

    def on_fleet_meeting(self, said: FleetMeeting) -> None:
        """What it is worth to another one to drive on, that has met this one."""
        self._said = {r: each for r, each in self._said.items() if self.now - each[1] <= HEARD_S}
        if said.other == self.robot:
            self._said[said.robot] = said, self.now

    def on_pose(self, pose: Pose) -> None:
        """Remember where the robot came along: what it has driven over is free."""
        here, before = (pose.x, pose.y), self._here
        self._here = here
        if before is not None and dist(before, here) > JUMP_M:
            self._trail = []
        state = self.latest(RobotState)
        forwards = state is not None and state.v > 0.0
        if not self._trail or (forwards and dist(self._trail[-1], here) >= STEP_M):
            self._trail = [*self._trail[1 - TRAIL :], here]

    # What it bids ---------------------------------------------------------------------------------

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:
        """Back off, or stand, while it is this robot that gives way."""
        here = pose.x, pose.y, pose.theta
        if not self.route.waypoints or self.in_dock is not None:
            self._over()
            self.why = "no goal" if self.in_dock is None else "the robot is in a dock"
            return None
        if not self._meets(here, obstacles):
            self.why = "no other robot stands before this one"
            return None
        utility = self._worth(pose)
        said = self._word_of(self._met)
        self._choose(utility, said, here)
        yields = self._yields_since is not None
        bid = self._give_way(here, obstacles) if yields else self._wait(said)
        aside = yields and not self._back_off
        self.publish(FleetMeeting(self.robot, self._met, utility, yields, aside))
        return bid

    def _wait(self, said: FleetMeeting | None) -> Bid | None:
        """Stand while the other one backs off: what stands there now is not there to stay."""
        if said is None:
            self.why = f"{self._met} says nothing"
        elif said.aside:
            self.why = f"{self._met} stands aside"
        else:
            return Bid(self.p.utility, (0.0, 0.0), reason=f"{self._met} is to give way")
        return None

    def _word_of(self, robot: str) -> FleetMeeting | None:
        """What it last said of this meeting; None: nothing, or long ago."""
        said, at = self._said.get(robot, (None, -inf))
        return said if self.now - at <= HEARD_S else None

    def _meets(self, here: Pose2, obstacles: Obstacles) -> bool:
        """Whether it has met another robot, `_met`, and that is not over."""
        others = self._robots.others(self.now)
        if self._met in others:
            word = self._word_of(self._met)
            begun = self._yields_since is not None or (word is not None and word.yields)
            if begun and not self._passed(here, others[self._met][1]):
                return True
        near = {
            robot: dist(here[:2], there[:2])
            for robot, (_, there) in others.items()
            if _ahead(here, there) and _ahead(there, here)
        }
        met = min(near, key=lambda robot: (near[robot], robot), default="")
        if not met or near[met] > self.p.near_m:
            self._over()
            return False
        if met != self._met:
            self._over()
            self._met = met
        said, there = others[met]
        if self._is_narrow(relative(here, there), obstacles):
            return True
        speed = max(abs(self.measured[0]), abs(said.v))
        if speed > self.p.still_m_s or near[met] > self.p.stands_m:
            self._stood_since = self.now
        return self.now - self._stood_since >= self.p.stood_s

    def _is_narrow(self, there: Pose2, obstacles: Obstacles) -> bool:
        """Whether they cannot pass each other on the way between them; `there` is as seen here."""
        x, y, _ = there
        away, beside = max(hypot(x, y), NEAR_M), self.body.outline.half_width + self.p.narrow_m
        sides = set()
        for p in obstacles.points:
            along, across = (p.x * x + p.y * y) / away, (p.y * x - p.x * y) / away
            if 0.0 < along < away and abs(across) < beside and hypot(p.x - x, p.y - y) > ROBOT_M:
                sides.add(across > 0.0)
        return len(sides) > 1

    def _passed(self, here: Pose2, there: Pose2) -> bool:
        x, y, _ = relative(here, there)
        long = self._yields_since is not None and self.now - self._yields_since > self.p.most_s
        return long or abs(atan2(y, x)) > PASSED_RAD or hypot(x, y) > self.p.apart_m

    def _worth(self, pose: Pose) -> float:
        """What it is worth to drive on, 0 to 1: the more, the later this robot is done."""
        behind = len(self._trail) * STEP_M
        if self.now < self._cannot_until or (self._yields_since is None and behind < AIM_M):
            return 1.0
        to_go = self.route.to_go(pose.x, pose.y)
        return 0.99 * to_go / (to_go + HALF_M)

    def _choose(self, utility: float, said: FleetMeeting | None, here: Pose2) -> None:
        """Give way to who says more; of two equal ones to the smaller name."""
        if said is None:
            return
        less = (utility, said.robot) < (said.utility, self.robot)
        if self._yields_since is None and less and not said.yields:
            self._yields_since = self._got_on_at = self.now
            self._back_off, self._met_at = True, here[:2]
            self.log(f"gives way to {said.robot}: {utility:.2f} against {said.utility:.2f}")
        elif self._yields_since is not None and not less and (said.yields or utility == 1.0):
            self._yields_since = None

    def _over(self) -> None:
        """It has met nobody."""
        self._met, self._yields_since, self._stood_since = "", None, self.now

    def _give_way(self, here: Pose2, obstacles: Obstacles) -> Bid:
        p = self.p
        far = dist(here[:2], self._met_at) >= p.back_m
        if (far and self._has_room(obstacles)) or not self._trail:
            self._back_off = False
        if not self._back_off:
            return Bid(p.utility, (0.0, 0.0), reason=f"stands until {self._met} has passed")
        v, w = self._backwards(here, obstacles)
        if self.now - self._got_on_at > p.held_s:
            self._cannot_until = self.now + p.cannot_s
        return Bid(p.utility, (v, w), reason=f"backs off for {self._met}")

    def _backwards(self, here: Pose2, obstacles: Obstacles) -> tuple[float, float]:
        """Speeds along the trail, back: an arc through the place to aim at."""
        while self._trail:
            x, y, _ = relative(here, (*self._trail[-1], 0.0))
            if x < 0.0 and hypot(x, y) >= AIM_M:
                break
            self._trail.pop()
            self._got_on_at = self.now
        else:
            return 0.0, 0.0
        v = -min(self.p.v, self.p.v_max or inf)
        bend = 2.0 * y / (x * x + y * y)
        w = clip(v * bend, -self.p.w_most, self.p.w_most)
        return self.limited(v, w, obstacles, self.p.safety)

    def _has_room(self, obstacles: Obstacles) -> bool:
        """Whether another robot could pass beside this one."""
        outline = self.body.outline
        beside = [
            p for p in obstacles.points if -outline.rear - STEP_M < p.x < outline.front + STEP_M
        ]
        left = min((p.y for p in beside if p.y > 0.0), default=inf)
        right = min((-p.y for p in beside if p.y <= 0.0), default=inf)
        return max(left, right) - outline.half_width >= self.p.beside_m


def _ahead(here: Pose2, there: Pose2) -> bool:
    """Whether a place is where a pose heads."""
    x, y, _ = relative(here, there)
    return abs(wrap(atan2(y, x))) < AHEAD_RAD
