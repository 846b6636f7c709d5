"""What a guard writes to brake a device without its agent, and when; sans-IO.

The guard's process (`armadico.runtime.guard`) and the virtual mesh share it. It imports nothing, so
that a guard starts fast.
"""

from __future__ import annotations

TYPE_CHECKING = False  # importing `typing` is slow
if TYPE_CHECKING:
    from typing import Final

REPEAT_S: Final = 0.1  # period of repeating the last braking bytes
REPEATS: Final = 2  # of the last braking bytes, once the agent has gone


class Braking:
    """The braking bytes of the agent's last write, and when the next of them is due."""

    def __init__(self, step_s: float) -> None:
        """`step_s`: time from one step to the next, s."""
        self._step_s = step_s
        self._steps: tuple[bytes, ...] = ()  # what is left to write; the last one stays
        self._repeats = 0  # how often the last one was written
        # When the next step is to be written, s; None: the device rests.
        self.due: float | None = None

    def renew(self, steps: tuple[bytes, ...], until: float) -> None:
        """The agent has written: `steps` brake the device from there; none: it rests.

        `until`: when the write ends to hold, s.
        """
        self._steps, self._repeats = steps, 0
        self.due = until if steps else None

    def at_once(self, now: float) -> None:
        """Brake now: the agent has gone, or a stop was ordered."""
        self.due = None if self.due is None else now

    def step(self, now: float) -> tuple[bytes, bool]:
        """The bytes of the next step, and whether it is new: no further repetition."""
        data, wait = self._steps[0], self._step_s
        if len(self._steps) > 1:
            self._steps = self._steps[1:]
        else:
            self._repeats += 1
            wait = REPEAT_S
        self.due = now + wait
        return data, self._repeats < 2

    @property
    def has_braked(self) -> bool:
        """Whether all steps since the agent's last write were written."""
        return self._repeats > 0

    @property
    def is_over(self) -> bool:
        """Whether a device without its agent was braked, or rests."""
        return self.due is None or self._repeats > REPEATS
