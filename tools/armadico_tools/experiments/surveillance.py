"""A day of surveillance: missions that arrive at random, alarms, people, a battery of two hours."""

from __future__ import annotations

import zlib
from collections import Counter
from random import Random
from typing import TYPE_CHECKING, Final

from msgspec import Struct, structs

from armadico.agents.interface.messages import MissionOrder
from armadico.agents.methods.energy import motor_power
from armadico.agents.missions.messages import (
    Alarm,
    Board,
    BoardMission,
    ChargeState,
    ChargeStatus,
    MissionEnd,
    Photo,
    StepEnd,
)
from armadico.config.moving import Moving
from armadico.config.profile import load_profile
from armadico.config.scenarios import Battery, Scenario, load_scenario, on_mission
from armadico.config.worlds import load_world
from armadico.core.messages import Message, RobotState
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import BatteryLevel, Truth
from armadico.runtime.errors import SocietyError
from armadico_tools.experiments.driving import counted
from armadico_tools.experiments.runner import Context, Experiment, Part
from armadico_tools.markdown import table

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

SCENARIO: Final = "surveillance"
HOURS: Final = 8.0

MISSION_EVERY_S: Final = 900.0
"""Mean time between missions, which are a Poisson process."""

ALARM_EVERY_S: Final = 3600.0
"""Mean time between alarms."""

ALARM_LASTS_S: Final = 300.0
"""Duration of an alarm."""

PRIORITIES: Final = (0.3, 0.5, 0.8)
PHOTOS: Final = 3
"""A mission takes photos of one to this many rooms."""

BATTERY_H: Final = 2.0
"""Time that a full battery lasts for a robot that drives half of the time."""

CRUISE_M_S: Final = 0.4
"""Speed for that time."""

GRACE_S: Final = 1800.0
"""Time after the last hour for finishing missions."""

OVER: Final = (MissionEnd.DONE, MissionEnd.FAILED, MissionEnd.CANCELLED)

NOTE: Final = (
    f"The building of thesis 3.6.1 with a dock and two people who walk in it; {HOURS:g} simulated"
    f" hours, sensors *real*. Missions (photos of one to {PHOTOS} rooms, priority"
    f" {', '.join(map(str, PRIORITIES))}) arrive at random, one in {MISSION_EVERY_S / 60:g}"
    f" minutes on average; alarms, one in {ALARM_EVERY_S / 3600:g} h. The battery lasts"
    f" {BATTERY_H:g} h with half of the time driven. *Refused*: not accepted, with a reason."
    f" *Lost*: an accepted mission without a reported end, {GRACE_S / 60:g} minutes after the"
    " last hour. *Failed*: ended with a reason. *Checked*: alarms that were checked; one that is"
    " over, or begins while no mission is active, need not be. *Suspended*, *resumed*: for a"
    " more urgent one, by the board. *Least V*: at rest, by the battery sensor. *Contacts*: of"
    " the body, without those that people caused."
)


class Day(Struct, frozen=True):
    """The result of one seed."""

    seed: int
    hours: float
    ordered: int
    refused: int
    done: int
    failed: int
    lost: int
    suspended: int
    resumed: int
    photos: int
    alarms: int
    checked: int
    charges: int
    least_v: float
    km: float
    contacts: int
    why: tuple[str, ...]  # of those that failed


def scenario() -> Scenario:
    """The building with people, and a battery that a day empties several times."""
    found = load_scenario(SCENARIO)
    profile = load_profile(found.robot)
    mean_v = 0.5 * (profile.battery.full_v + profile.battery.empty_v)
    amperes = profile.battery.idle_a + 0.5 * motor_power(profile, CRUISE_M_S) / mean_v
    halls = [room for room in load_world(found.world).rooms if room.name in ("hall", "R1")]
    people = tuple(
        Moving(kind="person", at=((r.x1 + r.x2) / 2 + 1.0, (r.y1 + r.y2) / 2)) for r in halls
    )
    return structs.replace(
        on_mission(found),
        mission=None,
        alarms=(),
        moving=people,
        battery=Battery(capacity_ah=BATTERY_H * amperes),
    )


def text_of(rooms: Sequence[str], priority: float) -> str:
    """A mission that takes photos of some rooms, as TOML."""
    steps = [f'  {{ do = "move", to = "{room}" }},\n  {{ do = "take-photo" }},' for room in rooms]
    head = f'title = "Photos of {", ".join(rooms)}"\nscenario = "{SCENARIO}"\n'
    head += f'priority = {priority}\non_alarm = "check-alarm"\nsteps = [\n'
    return head + "\n".join(steps) + "\n]\n"


class Watchman:
    """One day: orders missions, publishes alarms, and counts results."""

    def __init__(self, seed: int, hours: float) -> None:
        self.seed, self.end = seed, hours * 3600.0
        self.rehearsal = Rehearsal(scenario(), Options(seed=seed))
        rng = Random(f"surveillance/{seed}")
        self._rooms = [r.name for r in load_world(self.rehearsal.scenario.world).rooms]
        self._orders = list(self._arrivals(rng, MISSION_EVERY_S))
        self._alarms = list(self._arrivals(rng, ALARM_EVERY_S))
        self._ringing: list[tuple[float, str]] = []
        self._rng = rng
        self.ordered: dict[int, MissionEnd | None] = {}
        self.why: list[str] = []
        self.counts: Counter[str] = Counter()
        self.least_v = float("inf")
        self._charging = False
        self._odometer = 0.0
        self._at: tuple[float, float] | None = None
        self._touched: int | None = None
        kinds = (Board, BatteryLevel, ChargeStatus, Truth, Photo, RobotState)
        self.rehearsal.mesh.watch(self._on_message, *kinds)

    def go(self) -> Day:
        """Run the day, then what is active at its end."""
        rehearsal = self.rehearsal
        rehearsal.start()
        mesh = rehearsal.mesh
        begun = mesh.now
        last = begun + self.end
        while mesh.now < last:
            elapsed = mesh.now - begun
            self._due(elapsed)
            to_come = [*self._orders[:1], *self._alarms[:1], *(t for t, _ in self._ringing)]
            mesh.run(min([last, *(begun + t for t in to_come)]))
        for _, room in self._ringing:
            rehearsal.client.publish(Alarm(room, on=False))
        mesh.run(last + GRACE_S, lambda: all(end in OVER for end in self.ordered.values()))
        ends = Counter(self.ordered.values())
        return Day(
            seed=self.seed,
            hours=self.end / 3600.0,
            ordered=len(self.ordered),
            refused=self.counts["refused"],
            done=ends[MissionEnd.DONE],
            failed=ends[MissionEnd.FAILED],
            lost=sum(end not in OVER for end in self.ordered.values()),
            suspended=self.counts["suspended"],
            resumed=self.counts["resumed"],
            photos=self.counts["photos"],
            alarms=self.counts["alarms"],
            checked=self.counts["checked"],
            charges=self.counts["charges"],
            least_v=round(self.least_v, 2),
            km=round(self._odometer / 1e3, 2),
            contacts=counted(self._touched),
            why=tuple(self.why),
        )

    # Inside --------------------------------------------------------------------------------------

    def _arrivals(self, rng: Random, every: float) -> Iterator[float]:
        at = rng.expovariate(1.0 / every)
        while at < self.end:
            yield at
            at += rng.expovariate(1.0 / every)

    def _due(self, elapsed: float) -> None:
        while self._orders and self._orders[0] <= elapsed:
            self._orders.pop(0)
            self._order()
        while self._alarms and self._alarms[0] <= elapsed:
            self._alarms.pop(0)
            room = self._rng.choice(self._rooms)
            self._ringing.append((elapsed + ALARM_LASTS_S, room))
            self.counts["alarms"] += 1
            self.rehearsal.client.publish(Alarm(room))
        for end in [end for end in self._ringing if end[0] <= elapsed]:
            self._ringing.remove(end)
            self.rehearsal.client.publish(Alarm(end[1], on=False))

    def _order(self) -> None:
        rooms = self._rng.sample(self._rooms, self._rng.randint(1, PHOTOS))
        text = text_of(rooms, self._rng.choice(PRIORITIES))
        order = MissionOrder("photos", zlib.compress(text.encode()), None, "the day")
        try:
            reply = self.rehearsal.client.request_mission(order, find=5.0, again=0.0)
        except SocietyError as error:
            self.counts["refused"] += 1
            self.why.append(f"refused: {error}")
        else:
            self.ordered.setdefault(reply.mission, None)

    def _on_message(self, _key: str, message: Message, _now: float) -> None:
        match message:
            case Board():
                self._board(message)
            case BatteryLevel():
                self.least_v = min(self.least_v, message.volts)
            case ChargeStatus():
                charging = message.state is ChargeState.CHARGING
                self.counts["charges"] += charging and not self._charging
                self._charging = charging
            case Truth():
                self._touched = message.collisions - message.bumped
            case Photo():
                self.counts["photos"] += 1
            case RobotState():
                self._moved(message)

    def _board(self, board: Board) -> None:
        for mission in board.missions:
            before = self.ordered.get(mission.mission)
            if mission.mission in self.ordered and mission.state is before:
                continue
            if before in OVER:
                continue
            self.ordered[mission.mission] = mission.state
            self._became(mission, before)

    def _became(self, mission: BoardMission, before: MissionEnd | None) -> None:
        if mission.state in OVER:
            looks = (r for r in mission.course.results if r.step.startswith("check-alarm"))
            self.counts["checked"] += sum(look.end is StepEnd.DONE for look in looks)
        if mission.state is MissionEnd.SUSPENDED:
            self.counts["suspended"] += 1
        elif mission.state is MissionEnd.ACTIVE and before is MissionEnd.SUSPENDED:
            self.counts["resumed"] += 1
        elif mission.state is MissionEnd.FAILED:
            self.why.append(mission.note)

    def _moved(self, state: RobotState) -> None:
        if self._at is not None:
            step = ((state.x - self._at[0]) ** 2 + (state.y - self._at[1]) ** 2) ** 0.5
            self._odometer += step
        self._at = state.x, state.y


def day(task: tuple[int, float]) -> Day:
    return Watchman(*task).go()


def as_table(days: Sequence[Day]) -> str:
    """One row per day."""
    head = (
        *("seed", "ordered", "refused", "done", "failed", "lost", "suspended / resumed", "photos"),
        *("alarms", "checked", "charges", "least V", "km", "contacts"),
    )
    rows = [
        (
            *(str(d.seed), str(d.ordered), str(d.refused), str(d.done), str(d.failed), str(d.lost)),
            f"{d.suspended} / {d.resumed}",
            *(str(d.photos), str(d.alarms), str(d.checked), str(d.charges)),
            *(f"{d.least_v:.2f}", f"{d.km:.2f}", str(d.contacts)),
        )
        for d in days
    ]
    return table(head, rows)


def _report(context: Context) -> str:
    days = context.found["days"]
    context.summary = {str(each.seed): structs.asdict(each) for each in days}
    return as_table(days)


SURVEILLANCE: Final = Experiment(
    note=NOTE,
    parts=(Part("days", day, lambda context: [(seed, HOURS) for seed in context.seeds]),),
    report=_report,
    runs=10,
)
