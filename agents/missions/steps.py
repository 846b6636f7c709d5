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
    """A task that is one request, and done when that is."""
    if progress.state is Reach.DONE:
        return Done(said)
    if progress.state is Reach.FAILED:
        return Failed(progress.note)
    return Going(request)


def _elsewhere(room: str, beliefs: Beliefs) -> Failed | None:
    """That the robot is in another room than the one that is meant; "" means any."""
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
        """Drive; it is where the trajectory ends that it is there."""
        return _carried_out(Drive(self.arguments.to), progress, f"in {beliefs.room or 'no room'}")


class TakePhoto(Task):
    """Stands while a photo is taken; without a camera that is a record of where and when."""

    class Arguments(Task.Arguments, frozen=True):
        """In which room, if it matters, and for how long it stands."""

        room: str = ""
        seconds: Seconds = 3.0

    arguments: Arguments
    places: ClassVar[tuple[str, ...]] = ("room",)
    breaks_off: ClassVar[bool] = False

    def tick(self, beliefs: Beliefs, progress: Progress) -> Verdict:
        """Stand still, then say what was taken."""
        at, asked = beliefs.at, self.arguments
        if at is None:
            return Failed("nobody knows where the robot is")
        if elsewhere := _elsewhere(asked.room, beliefs):
            return elsewhere
        if progress.elapsed < asked.seconds:
            return Going(Stand())
        photo = Photo(0, beliefs.room, at.x, at.y, at.theta, beliefs.deviation)
        return Done(f"photo in {beliefs.room or 'no room'}", photo)


class CheckAlarm(Task):
    """Stands in a room and looks whether its alarm is still on."""

    class Arguments(Task.Arguments, frozen=True):
        """The room with the alarm, none: where the robot is; and for how long it looks."""

        room: str = ""
        seconds: Seconds = 2.0

    arguments: Arguments
    places: ClassVar[tuple[str, ...]] = ("room",)
    breaks_off: ClassVar[bool] = False

    def tick(self, beliefs: Beliefs, progress: Progress) -> Verdict:
        """Stand still, then say what was seen."""
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
    """Has the robot charged at a dock, as far as it is asked for."""

    class Arguments(Task.Arguments, frozen=True):
        """The share of a full battery."""

        until: Annotated[float, Meta(gt=0, le=1)] = 0.9

    arguments: Arguments

    def tick(self, beliefs: Beliefs, progress: Progress) -> Verdict:
        left = "" if beliefs.battery is None else f" to {beliefs.battery:.0%}"
        return _carried_out(Charge(self.arguments.until), progress, f"charged{left}")


class Explore(Task):
    """Has a rectangle of the world mapped."""

    class Arguments(Task.Arguments, frozen=True):
        """Which: x1, y1, x2, y2 in m; none: all of the world."""

        within: tuple[Metres, Metres, Metres, Metres] | None = None

    arguments: Arguments

    def tick(self, beliefs: Beliefs, progress: Progress) -> Verdict:  # noqa: ARG002
        return _carried_out(tasks.Explore(self.arguments.within), progress, "mapped")
