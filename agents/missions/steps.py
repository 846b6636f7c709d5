"""The tasks that come with Armadico: move, take-photo, check-alarm, wait, dock, explore (3.6.1)."""

from __future__ import annotations

from typing import Annotated, ClassVar

from msgspec import Meta

from armadico.agents.missions import task as tasks
from armadico.agents.missions.messages import Photo
from armadico.agents.missions.task import (
    Beliefs,
    Charge,
    Done,
    Drive,
    Failed,
    Going,
    Progress,
    Reach,
    Request,
    Stand,
    Task,
    Verdict,
)

Seconds = Annotated[float, Meta(ge=0, le=86_400)]
Metres = Annotated[float, Meta(ge=-1e4, le=1e4)]


def _carried_out(request: Request, progress: Progress, said: str) -> Verdict:
    """Return the verdict of a task that consists of one request."""
    if progress.state is Reach.DONE:
        return Done(said)
    if progress.state is Reach.FAILED:
        return Failed(progress.note)
    return Going(request)


def _elsewhere(room: str, beliefs: Beliefs) -> Failed | None:
    """Return a failure if the robot is not in the given room; "" is any room."""
    if room in ("", beliefs.room):
        return None
    return Failed(f"the robot is in {beliefs.room or 'no room'}, not in {room}")


class Move(Task):
    """Has the robot driven to a room, a goal or a dock of the world."""

    class Arguments(Task.Arguments, frozen=True):
        to: str

    arguments: Arguments
    places: ClassVar[tuple[str, ...]] = ("to",)

    def tick(self, beliefs: Beliefs, progress: Progress) -> Verdict:
        return _carried_out(Drive(self.arguments.to), progress, f"in {beliefs.room or 'no room'}")


class TakePhoto(Task):
    """Stands while a photo is taken; without a camera the photo is a record of place and time."""

    class Arguments(Task.Arguments, frozen=True):
        """The room, if it matters, and how long the robot stands."""

        room: str = ""
        seconds: Seconds = 3.0

    arguments: Arguments
    places: ClassVar[tuple[str, ...]] = ("room",)
    breaks_off: ClassVar[bool] = False

    def tick(self, beliefs: Beliefs, progress: Progress) -> Verdict:
        at, arguments = beliefs.at, self.arguments
        if at is None:
            return Failed("the robot's pose is not known")
        if elsewhere := _elsewhere(arguments.room, beliefs):
            return elsewhere
        if progress.elapsed < arguments.seconds:
            return Going(Stand())
        photo = Photo(0, beliefs.room, at.x, at.y, at.theta, beliefs.deviation)
        return Done(f"photo in {beliefs.room or 'no room'}", photo)


class CheckAlarm(Task):
    """Stands in a room and checks whether its alarm is still on."""

    class Arguments(Task.Arguments, frozen=True):
        """The room with the alarm (empty: the present one), and how long it is observed."""

        room: str = ""
        seconds: Seconds = 2.0

    arguments: Arguments
    places: ClassVar[tuple[str, ...]] = ("room",)
    breaks_off: ClassVar[bool] = False

    def tick(self, beliefs: Beliefs, progress: Progress) -> Verdict:
        if elsewhere := _elsewhere(self.arguments.room, beliefs):
            return elsewhere
        room = beliefs.room
        if progress.elapsed < self.arguments.seconds:
            return Going(Stand())
        return Done(
            f"the alarm in {room or 'no room'} is {'on' if room in beliefs.alarms else 'off'}"
        )


class Wait(Task):
    class Arguments(Task.Arguments, frozen=True):
        seconds: Seconds

    arguments: Arguments

    def tick(self, beliefs: Beliefs, progress: Progress) -> Verdict:  # noqa: ARG002
        return Going(Stand()) if progress.elapsed < self.arguments.seconds else Done()


class Dock(Task):
    """Has the robot charged at a dock, up to a share of a full battery."""

    class Arguments(Task.Arguments, frozen=True):
        until: Annotated[float, Meta(gt=0, le=1)] = 0.9

    arguments: Arguments

    def tick(self, beliefs: Beliefs, progress: Progress) -> Verdict:
        left = "" if beliefs.battery is None else f" to {beliefs.battery:.0%}"
        return _carried_out(Charge(self.arguments.until), progress, f"charged{left}")


class Explore(Task):
    """Has a rectangle of the world explored."""

    class Arguments(Task.Arguments, frozen=True):
        """x1, y1, x2, y2 in m; without: all of the world."""

        within: tuple[Metres, Metres, Metres, Metres] | None = None

    arguments: Arguments

    def tick(self, beliefs: Beliefs, progress: Progress) -> Verdict:  # noqa: ARG002
        return _carried_out(tasks.Explore(self.arguments.within), progress, "mapped")
