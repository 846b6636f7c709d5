"""The resources that agents share, each declared once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import isfinite
from typing import Any, Final

from armadico.core.installed import load_all
from armadico.core.messages import LARGEST, Action, Message, MessageError, decode, encode

LEAST_SILENCE_S: Final = 0.3
"""Without a valid command for so long the owner rests a resource, unless that says otherwise."""


@dataclass(frozen=True)
class Resource:
    """Something that one agent at a time may use.

    An action is either numbers, named by `parameters`, or one `message` of the resource's own.

    Attributes:
        name: What it is called in keys and messages.
        parameters: The numbers of an action, in their order.
        scale: The size of each number that counts as big in an exchange (3.13).
        neutral: The action that does nothing; an empty one for a resource of messages.
        message: The type of an action that is no numbers.
        margin: By how much a contender's utility must exceed the holder's; 0 is the thesis.
        exchange: How it changes hands by default, one of `armadico.core.exchange.EXCHANGES`.
        period_s: From one of its cycles to the next, counted by its owner; None: the robot's cycle.
        silence_s: How long its owner goes on without a valid command; None: 0.3 s, or three of its
            cycles if that is longer.
        stops: Whether the robot's stop rests it; so it is for all that moves.
        command_key: The key that its commands travel on.
    """

    name: str
    parameters: tuple[str, ...] = ()
    scale: tuple[float, ...] = ()
    neutral: Action = ()
    message: type[Message] | None = None
    margin: float = 0.05
    exchange: str = "smooth"
    period_s: float | None = None
    silence_s: float | None = None
    stops: bool = True
    command_key: str = "resource/{resource}/cmd/{instance}"

    def __post_init__(self) -> None:
        """Raise ValueError, with the resource's name, for what cannot be meant."""
        fault = self._fault()
        if fault:
            raise ValueError(f"resource {self.name!r}: {fault}")

    def _fault(self) -> str:
        if not self.name or set(self.name) & set("/*$?# "):
            return (
                "its name is one part of a key: neither empty nor with any of / * $ ? # or blanks"
            )
        if (self.message is None) == (not self.parameters):
            return "its actions are numbers (parameters) or a message: one of both"
        if self.message is None and not len(self.parameters) == len(self.scale) == len(
            self.neutral
        ):
            return "as many numbers in scale and neutral as there are parameters"
        if not all(isfinite(size) and size > 0.0 for size in self.scale):
            return "every scale is above 0"
        if self.period_s is not None and not 0.001 <= self.period_s <= 60.0:
            return "its period is from 1 ms to 60 s"
        if "{instance}" not in self.command_key:
            return "its command key tells publishers apart: it needs {instance}"
        return ""

    @property
    def signature(self) -> str:
        """What all who share it must mean by it."""
        what = ", ".join(self.parameters) if self.message is None else self.message.__name__
        rate = "" if self.period_s is None else f" each {self.period_s:g} s"
        return f"{self.name}({what}){rate}"

    @property
    def utility_key(self) -> str:
        """The key of its claims."""
        return f"resource/{self.name}/utility"

    @property
    def ack_key(self) -> str:
        """The key of its owner's acknowledgements."""
        return f"resource/{self.name}/ack"

    def command_key_of(self, instance: str) -> str:
        """The key of one instance's commands."""
        return self.command_key.format(resource=self.name, instance=instance)

    @property
    def command_pattern(self) -> str:
        """The key expression of everybody's commands."""
        return self.command_key_of("*")

    def silence(self, period: float) -> float:
        """How long, s, its owner goes on without a valid command, at a period in s."""
        return max(LEAST_SILENCE_S, 3 * period) if self.silence_s is None else self.silence_s

    def pack(self, action: Any) -> Action:
        """A bid's action as it travels. Raises ValueError saying what is wrong with it."""
        if self.message is not None:
            if type(action) is not self.message:
                raise ValueError(f"{self.name} takes a {self.message.__name__}, not {action!r}")
            return encode(action)
        try:
            if isinstance(action, str | bytes):
                raise TypeError
            numbers = tuple(map(float, action))
        except (TypeError, ValueError):
            raise ValueError(f"{self.name} takes {self.parameters}, not {action!r}") from None
        fault = self.fault(numbers)
        if fault:
            raise ValueError(fault)
        return numbers

    def unpack(self, action: Action) -> Any:
        """The numbers, or the message, of an action that `fault` finds nothing wrong with."""
        if self.message is None:
            return action
        assert isinstance(action, bytes), "an action of messages is encoded"
        return decode(action, self.message) if action else None

    def fault(self, action: Action) -> str:
        """What is wrong with an action's shape; nothing if it is one of this resource."""
        if self.message is not None:
            if not isinstance(action, bytes):
                return f"{self.name} takes a {self.message.__name__}, not numbers"
            try:
                decode(action, self.message)
            except MessageError as error:
                return f"{self.name}: {error}"
            return ""
        if isinstance(action, bytes) or len(action) != len(self.parameters):
            return f"{self.name} takes {len(self.parameters)} numbers {self.parameters}"
        if not all(abs(number) <= LARGEST for number in action):  # NaN is not
            return f"{self.name} takes finite numbers up to {LARGEST:g}, not {action}"
        return ""


_declared: dict[str, Resource] = {}


def declare(resource: Resource) -> Resource:
    """Note a resource; whoever contests or owns it does. Raises ValueError if two differ."""
    known = _declared.setdefault(resource.name, resource)
    if known != resource:
        raise ValueError(
            f"resource {resource.name!r} is declared twice, and differently: {known} and {resource}"
        )
    return resource


def differently(theirs: Iterable[str], ours: Iterable[str]) -> tuple[str, str] | None:
    """Of a resource that two sides declare differently both signatures; None: of none."""
    own = {each.partition("(")[0]: each for each in ours}
    pairs = ((each, own.get(each.partition("(")[0], each)) for each in theirs)
    return next((pair for pair in pairs if pair[0] != pair[1]), None)


def declared(name: str) -> Resource | None:
    """The resource of a name, if it is declared by what is installed or has been imported."""
    load_all()
    return _declared.get(name)


WHEELS = declare(
    Resource(
        name="wheels",
        parameters=("v", "w"),
        scale=(0.75, 1.745),  # m/s and rad/s: the fast controller's and the profile's usual maxima
        neutral=(0.0, 0.0),
        command_key="robot/cmd/{instance}",
    )
)
"""The robot's motion. The robot agent owns the port and obeys whoever holds this."""
