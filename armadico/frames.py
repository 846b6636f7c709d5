"""Frames: the one clock that every process shares, without comparing any two clocks.

The robot agent numbers its status packets; each message says which one it answers. Whatever took
too long, whoever hung, however wrong a host's time: an old frame is seen to be old.
"""

from __future__ import annotations

from collections import deque

from armadico.messages import Frame

PERIOD = 0.1
"""Seconds from one frame to the next: the status packet's cycle (thesis 3.7.1)."""

AHEAD = 3
"""A message more frames ahead of the newest `RobotState` than this is refused."""

EPOCHS_REMEMBERED = 64


class FrameClock:
    """The newest frame, moved only by `RobotState`.

    An epoch not seen before is newer; one that has been left is never returned to.
    """

    def __init__(self, fresh_frames: int = 3) -> None:
        self.newest: Frame | None = None
        self.first: Frame | None = None  # the first frame heard of this epoch
        self.heard_at = -1e9
        self.fresh_frames = fresh_frames
        self._left: deque[int] = deque(maxlen=EPOCHS_REMEMBERED)

    def advance(self, frame: Frame, now: float) -> bool:
        """Take a `RobotState`'s frame; False if it is not newer than what is known."""
        newest = self.newest
        if newest is None or frame.epoch != newest.epoch:
            if frame.epoch in self._left:
                return False
            if newest is not None:
                self._left.append(newest.epoch)
            self.first = frame
        elif frame.number <= newest.number:
            return False
        self.newest, self.heard_at = frame, now
        return True

    def age(self, frame: Frame) -> int | None:
        """How many frames behind the newest, negative if ahead; None in another epoch."""
        newest = self.newest
        if newest is None or frame.epoch != newest.epoch:
            return None
        return newest.number - frame.number

    def fresh(self, frame: Frame, within: int | None = None) -> bool:
        """Whether something that answers this frame may still be acted upon.

        `within` so many frames; None: the clock's own number.
        """
        age = self.age(frame)
        return age is not None and -AHEAD <= age <= (within or self.fresh_frames)

    def alive(self, now: float) -> bool:
        """Whether the robot agent has been heard within the frames that count as fresh."""
        return now - self.heard_at <= self.fresh_frames * PERIOD
