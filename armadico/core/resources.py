"""The resources that agents share, each declared once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import isfinite
from typing import Final

from armadico.core.installed import load_all
from armadico.core.messages import LARGEST, Action, Message, MessageError, decode, encode

LEAST_SILENCE_S: Final = 0.3  # the shortest default of the owner's command timeout, s


@dataclass(frozen=True)
class Resource:
    """A resource that one agent at a time may use.

    An action is either numbers, named by `parameters`, or one `message` of the resource's own.

    Attributes:
        name: Its name in keys and messages.
        parameters: The names of an action's numbers, in order.
        scale: The size of each number that counts as big in an exchange (3.13).
        neutral: The action that does nothing; empty for a resource of messages.
        message: The type of an action that is a message.
        margin: By how much a contender's utility must exceed the holder's; 0 in the thesis.
        exchange: The default exchange, one of `armadico.core.exchange.EXCHANGES`.
        period_s: Duration of its cycles, counted by its owner, s; None: the robot's cycle.
        silence_s: The owner's command timeout, s; None: 0.3 s, or three of its cycles if longer.
        stops: Whether the robot's stop rests it: true for all that moves.
        command_key: The key of its commands.
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
        """Raise ValueError, with the resource's name, for inconsistent attributes."""
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
        """The declaration that all agents sharing the resource must agree on."""
        what = ", ".join(self.parameters) if self.message is None else self.message.__name__
        rate = "" if self.period_s is None else f" each {self.period_s:g} s"
        return f"{self.name}({what}){rate}"

    def utility_key_of(self, instance: str) -> str:
        return f"resource/{self.name}/utility/{instance}"

    @property
    def ack_key(self) -> str:
        return f"resource/{self.name}/ack"

    def command_key_of(self, instance: str) -> str:
        return self.command_key.format(resource=self.name, instance=instance)

    @property
    def command_pattern(self) -> str:
        return self.command_key_of("*")

    def silence(self, period: float) -> float:
        """Return the owner's command timeout, s, at a cycle of `period` s."""
        return max(LEAST_SILENCE_S, 3 * period) if self.silence_s is None else self.silence_s

    def pack(self, action: Iterable[float] | Message) -> Action:
        """Return a bid's action as it is sent. Raises ValueError if it is not of this resource."""
        if self.message is not None:
            if type(action) is not self.message:
                raise ValueError(f"{self.name} takes a {self.message.__name__}, not {action!r}")
            return encode(action)
        try:
            if isinstance(action, str | bytes | Message):
                raise TypeError
            numbers = tuple(map(float, action))
        except (TypeError, ValueError):
            raise ValueError(f"{self.name} takes {self.parameters}, not {action!r}") from None
        fault = self.fault(numbers)
        if fault:
            raise ValueError(fault)
        return numbers

    def unpack(self, action: Action) -> Action | Message | None:
        """Return the numbers or the message of an action without a `fault`."""
        if self.message is None:
            return action
        assert isinstance(action, bytes), "an action of messages is encoded"
        return decode(action, self.message) if action else None

    def fault(self, action: Action) -> str:
        """Return what is wrong with an action's shape; "" if it is one of this resource."""
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
    """Register a resource. Raises ValueError if it is declared already and differently."""
    known = _declared.setdefault(resource.name, resource)
    if known != resource:
        raise ValueError(
            f"resource {resource.name!r} is declared twice, and differently: {known} and {resource}"
        )
    return resource


def differently(theirs: Iterable[str], ours: Iterable[str]) -> tuple[str, str] | None:
    """Return both signatures of a resource that two sides declare differently; None: of none."""
    own = {each.partition("(")[0]: each for each in ours}
    pairs = ((each, own.get(each.partition("(")[0], each)) for each in theirs)
    return next((pair for pair in pairs if pair[0] != pair[1]), None)


def declared(name: str) -> Resource | None:
    """Return a resource that is declared by an installed or imported module, else None."""
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
"""The robot's motion. The robot agent owns it and obeys its holder."""
