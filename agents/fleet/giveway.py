"""The giveway agent: has the robot wait before a passage that another robot of its fleet holds."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from math import dist, hypot, inf
from typing import Annotated, ClassVar, Final

from msgspec import Meta

from armadico.agents.fleet.messages import PASSAGES, FleetPassages
from armadico.agents.fleet.passages import Passages, passages_of
from armadico.agents.fleet.sharing import Sharing
from armadico.agents.methods.geometry import clip
from armadico.agents.methods.known_robots import KnownRobots
from armadico.config.worlds import load_world
from armadico.core import agent
from armadico.core.exchange import Bid
from armadico.core.mechanisms import chosen
from armadico.core.messages import Message, RobotState
from armadico.core.parameters import Safety
from armadico.core.resources import Resource
from armadico.core.services import service_of
from armadico.mobile.behaviour import LOST_M, Behaviour
from armadico.mobile.geometry import Pose2, relative
from armadico.mobile.messages import FleetAwards, FleetPose, FleetProposals, Pose
from armadico.mobile.obstacles import Obstacles

Metres = Annotated[float, Meta(gt=0, le=100)]

PERIOD_S: Final = 0.5  # the cycle of the fleet's passages

# Cycles that a passage is held before the robot enters: a better bid is known by then.
CONFIRMED: Final = 2

MARGIN: Final = 0.05

STEP_M: Final = 0.1  # the distance between places of the trail

TRAIL: Final = 200  # places of the trail

JUMP_M: Final = 0.5  # a pose that jumps by this much ends the trail

AIM_M: Final = 0.35  # it backs off towards the place of the trail at this distance

STANDS_S: Final = 1.0  # after a bid for the wheels the robot counts as waiting for this time

SPOKEN_S: Final = 5.0  # messages of another robot are stale after this time

# A silent robot inside a passage is assumed to be there for this time. By then the sensors of a
# waiting robot detect it.
UNSEEN_S: Final = 10.0

# A robot that has left one passage stops this far before the next; `stop_m` only where there is
# space.
BEFORE_M: Final = 0.5

# A robot this near to a passage that another robot holds is in its way, and backs off.
MOUTH_M: Final = 0.8

HALF_S: Final = 60.0  # a contender has half of the bonus for waiting after this time


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """Where a robot contends for a passage, and where it waits."""

    namespace: Annotated[str, Meta(min_length=1)] = "robot1"
    world: Annotated[str, Meta(min_length=1)] | None = None
    v: Annotated[float, Meta(gt=0, le=1)] = 0.2  # m/s, backwards
    v_max: Annotated[float, Meta(gt=0, le=10)] | None = None  # a scenario's limit
    w_most: Annotated[float, Meta(gt=0, le=2)] = 0.5  # rad/s
    contend_m: Metres = 4.0  # it contends for passages of its path this far ahead
    stop_m: Metres = 2.0  # it waits this far before them
    left_m: Metres = 0.5  # it has left a passage at this distance
    queue_m: Metres = 1.2  # its distance from a robot ahead that needs the same passage
    utility: Annotated[float, Meta(gt=0, le=1)] = 0.95
    safety: Safety = Safety(slow=0.2)


@cache
def resource_of(passage: int) -> Resource:
    """Return a passage's resource. Its action is the robot's distance from it, m."""
    return Resource(
        name=f"passage-{passage}",
        parameters=("away_m",),
        scale=(1.0,),
        neutral=(0.0,),
        margin=MARGIN,
        exchange="abrupt",
        period_s=PERIOD_S,
        stops=False,
    )


class GiveWay(Behaviour):
    """Contends for the passages on the robot's path, and for the wheels while it has to wait.

    A passage is a part of the map where two robots cannot pass each other (`passages.py`). It is a
    resource between robots, as a task is (`sharing.py`). The robot contends for the next passage,
    enters while it holds it, and releases it when it has left it.
    """

    name = "giveway"
    reacts_to = Obstacles
    receives: ClassVar[tuple[type[Message], ...]] = (
        *Behaviour.receives,
        *(FleetPose, FleetPassages, FleetAwards),
    )
    provides: ClassVar[tuple[type[Message], ...]] = (FleetPassages, FleetProposals)
    competes_later: tuple[str, ...] = ("passage-",)
    parameters = Parameters
    launched_with = ("v_max", "namespace", "world")
    changeable: ClassVar = {
        "v": "m/s",
        "v_max": "m/s",
        "stop_m": "m",
    }
    needs_goal: ClassVar[bool] = False  # a way that waits is one, too: it looks for itself
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self.robot = self.p.namespace.rpartition("/")[2]
        self.key_names = {"robot": self.robot}
        self.passages: Passages | None = None
        if self.p.world is not None:
            self.passages = passages_of(load_world(self.p.world))
            if not self.passages.count:
                self.competes_later = ()
        self.sharing: Sharing | None = None
        self._robots = KnownRobots(self.robot)
        self._last_seen: dict[str, tuple[FleetPose, float]] = {}
        self._received: dict[str, tuple[FleetPassages, float]] = {}
        self._next: tuple[float, int] | None = None  # passage that the way enters; how far, m
        self._through: tuple[int, ...] = ()
        self._inside: int | None = None
        self._stood_at = -inf  # when it last had the robot wait, s
        self._waits_since: dict[int, float] = {}
        self._trail: list[tuple[float, float]] = []
        self._here: tuple[float, float] | None = None

    def on_start(self) -> None:
        """Begin to share the passages of the map, if it has any."""
        if self.passages is not None and self.passages.count:
            resources = [resource_of(number) for number in range(self.passages.count)]
            epoch = self.passages.id
            self.sharing = Sharing(
                *(self.instance, epoch, resources, self.rng, self.now),
                lambda resource, clock: chosen(resource, self, clock)[1],
            )
            self.wake_at(self.sharing.wakeup)

    # Inputs ---------------------------------------------------------------------------------------

    def on_fleet_pose(self, pose: FleetPose) -> None:
        """Update the pose of another robot."""
        if pose.robot != self.robot:
            self._robots.update(pose, self.now)
            self._last_seen[pose.robot] = pose, self.now

    def on_fleet_passages(self, message: FleetPassages) -> None:
        """Process the passages that another robot holds and drives through."""
        if message.robot == self.robot or self.sharing is None:
            return
        if message.cycle.epoch != self.sharing.clock.epoch:
            why = f"{message.robot} has another map: its passages are not these, and are ignored"
            self.refuse(service_of(FleetPassages).key, why)
            return
        self._received[message.robot] = message, self.now
        if self.sharing.on_other_claims(message.instance, message.cycle, message.claims, self.now):
            self._take_turn()
        self._publish_claims()

    def on_fleet_awards(self, message: FleetAwards) -> None:
        """Process an arbiter's decisions about passages."""
        why = "" if self.sharing is None else self.sharing.on_awards(message, self.now)
        if why:
            self.refuse(service_of(FleetAwards).key, why)

    def on_wakeup(self) -> None:
        """Count the fleet's cycles on, and take over what is free."""
        if self.sharing is not None:
            if self.sharing.wake(self.now):
                self._take_turn()
            self._publish_claims()

    def on_pose(self, pose: Pose) -> None:
        """Update the pose and the trail: what the robot has driven over is free."""
        here, before = (pose.x, pose.y), self._here
        self._here = here
        if before is not None and dist(before, here) > JUMP_M:
            self._trail = []
        state = self.latest(RobotState)
        forwards = state is not None and state.v > 0.0
        if not self._trail or (forwards and dist(self._trail[-1], here) >= STEP_M):
            self._trail = [*self._trail[1 - TRAIL :], here]

    # The passages ---------------------------------------------------------------------------------

    def _find_passages(self) -> None:
        """Find out which passages are on the way, and how far the next one is."""
        passages, here = self.passages, self._here
        if passages is None or here is None:
            return
        self._inside = passages.at(*here)
        left = [(w.x, w.y) for w in self.route.waypoints[self.route.leg :]]
        entered = passages.along([here, *left]) if left else []
        ahead = [(away, each) for away, each in entered if each != self._inside]
        self._next = ahead[0] if ahead else None
        ends = passages.at(*left[-1]) if left else None
        through = [each for _, each in entered if each != ends]
        self._through = tuple(dict.fromkeys(through))[:PASSAGES]

    def _take_turn(self) -> None:
        assert self.sharing is not None, "a cycle of shared passages has begun"
        self._find_passages()
        self.sharing.turn(self._bids, self.now)

    def _bids(self) -> Mapping[int, Bid]:
        """Bids for the passage that the robot is in, those it has not left, and the next one."""
        sharing, passages, here = self.sharing, self.passages, self._here
        if sharing is None or passages is None or here is None:
            return {}
        bids = {}
        kept = {self._inside} if self._inside is not None else set()
        kept |= {each for each in sharing.held if passages.near(each, *here, self.p.left_m)}
        for each in kept:
            bids[each] = Bid(1.0, (0.0,))
        wanted = self._next if self._may_drive() else None
        if wanted is not None and wanted[1] not in bids and wanted[0] <= self.p.contend_m:
            away, each = wanted
            if (utility := self._utility(each, away)) is not None:
                bids[each] = Bid(utility, (away,))
        waiting = wanted[1] if wanted is not None and wanted[1] in bids else None
        since = self._waits_since.get(waiting, self.now) if waiting is not None else self.now
        self._waits_since = {} if waiting is None else {waiting: since}
        return bids

    def _may_drive(self) -> bool:
        """Whether the robot can enter a passage at all: otherwise it leaves it to others."""
        pose = self.fresh(Pose)
        may = self.stopped is None and not self.led
        return may and pose is not None and pose.deviation <= LOST_M

    def _utility(self, passage: int, away: float) -> float | None:
        """What the next passage is worth; None if the robot must not enter it now."""
        sharing = self.sharing
        assert sharing is not None, "of shared passages"
        held, occupied = passage in sharing.held, self._occupied(passage)
        if held and not occupied and sharing.confirmed(passage, CONFIRMED):
            return 1.0
        if occupied and (held or sharing.by_ballots):
            return None  # who is inside needs it first; an arbiter is to know who came first
        if passage not in self._through and any(
            passage in message.through
            for message, at in self._received.values()
            if self.now - at <= SPOKEN_S
        ):
            return None  # it would stand inside, and others have to go through
        waited = self.now - self._waits_since.get(passage, self.now)
        near = 1.0 - away / self.p.contend_m
        return 0.45 + 0.3 * waited / (waited + HALF_S) + 0.2 * max(near, 0.0)

    def _occupied(self, passage: int) -> bool:
        """Whether another robot is inside, as far as it is known."""
        assert self.passages is not None, "of a map"
        return any(
            self.passages.at(seen.x, seen.y) == passage
            for seen, at in self._last_seen.values()
            if self.now - at <= UNSEEN_S
        )

    def _publish_claims(self) -> None:
        sharing = self.sharing
        assert sharing is not None, "of shared passages"
        claims = sharing.next_claims()
        if claims is not None:
            waits = self.now - self._stood_at <= STANDS_S
            self.publish(FleetPassages(self.robot, self.instance, *claims, self._through, waits))
        proposals = sharing.next_proposals(self.robot)
        if proposals is not None:
            self.publish(proposals)
        self.wake_at(sharing.wakeup)

    # The wheels -----------------------------------------------------------------------------------

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:
        """Stand, or back off, while the robot must not go on."""
        here = pose.x, pose.y, pose.theta
        self._stood_at = -inf
        if not self.route.waypoints or self.led:
            self.why = "the robot is in a dock" if self.led else "no goal"
            return None
        if self.sharing is None:
            self.why = "the map has no passages" if self.passages else "there is no map"
            return None
        self._find_passages()
        bid = self._leave(here, obstacles) or self._stop(here, obstacles)
        if bid is not None:
            self._stood_at = self.now
        else:
            self.why = "no passage ahead that another robot may use"
        return bid

    def _leave(self, here: Pose2, obstacles: Obstacles) -> Bid | None:
        """Back out of a passage that another robot holds, as far as the trail leads."""
        sharing, inside = self.sharing, self._inside
        assert sharing is not None, "of shared passages"
        if inside is None or inside in sharing.held:
            return None
        if not sharing.taken_by(inside):
            return Bid(self.p.utility, (0.0, 0.0), reason=f"waits for passage {inside}")
        return self._back_off(here, obstacles, inside)

    def _back_off(self, here: Pose2, obstacles: Obstacles, passage: int) -> Bid:
        v, w = self._backwards(here, obstacles)
        return Bid(self.p.utility, (v, w), reason=f"backs off for the holder of passage {passage}")

    def _stop(self, here: Pose2, obstacles: Obstacles) -> Bid | None:
        """Stand before a passage that the robot does not hold, or behind a robot that does so."""
        sharing, passages = self.sharing, self.passages
        assert sharing is not None, "of shared passages"
        assert passages is not None, "of a map"
        if self._next is None:
            return None
        away, passage = self._next
        if sharing.confirmed(passage, CONFIRMED) and not self._occupied(passage):
            return None
        leaving = any(passages.near(each, *here[:2], self.p.left_m) for each in sharing.held)
        if away < MOUTH_M and not leaving and sharing.taken_by(passage):
            return self._back_off(here, obstacles, passage)
        if away <= (BEFORE_M if leaving else self.p.stop_m):
            return Bid(self.p.utility, (0.0, 0.0), reason=f"waits for passage {passage}")
        near = away <= self.p.contend_m and not leaving
        if near and (ahead := self._queued_ahead(here, passage)):
            return Bid(self.p.utility, (0.0, 0.0), reason=f"waits behind {ahead}")
        return None

    def _queued_ahead(self, here: Pose2, passage: int) -> str:
        """Return a robot just ahead that needs the same passage, or "".

        Otherwise two robots side by side would drive on until they stand beside each other, where
        they cannot turn.
        """
        assert self.sharing is not None, "of shared passages"
        holder = self.sharing.taken_by(passage)
        for robot, (_, there) in self._robots.others(self.now).items():
            message, at = self._received.get(robot, (None, -inf))
            if message is None or passage not in message.through or self.now - at > SPOKEN_S:
                continue
            if message.instance == holder:
                continue
            x, y, _ = relative(here, there)
            if x > 0.0 and hypot(x, y) < self.p.queue_m:
                return robot
        return ""

    def _backwards(self, here: Pose2, obstacles: Obstacles) -> tuple[float, float]:
        """Return speeds backwards along the trail: an arc through the place to aim at."""
        while self._trail:
            x, y, _ = relative(here, (*self._trail[-1], 0.0))
            if x < 0.0 and hypot(x, y) >= AIM_M:
                break
            self._trail.pop()
        else:
            return 0.0, 0.0
        v = -min(self.p.v, self.p.v_max or inf)
        bend = 2.0 * y / (x * x + y * y)
        w = clip(v * bend, -self.p.w_most, self.p.w_most)
        return self.limited(v, w, obstacles, self.p.safety)
