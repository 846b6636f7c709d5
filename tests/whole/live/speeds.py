"""What the packets of a tapped line say about the wheels."""

from __future__ import annotations

from dataclasses import dataclass

from armadico.bridge.p2os.commands import Cmd, Command, decode_command
from armadico.bridge.p2os.packets import Decoder
from armadico.bridge.p2os.status import STATUS_TYPES
from armadico_tools.faults.serial_tap import Tap


@dataclass(frozen=True)
class Status:
    """A status packet."""


Packet = Command | Status


class PacketTap(Tap):
    """A tap whose `packets` are what passed, both ways, in order."""

    def __init__(self, upstream: str) -> None:
        self.packets: list[Packet] = []
        sent, received = Decoder(), Decoder()

        def written(data: bytes, at: float) -> None:
            self.packets += [decode_command(payload) for payload in sent.feed(data, at)]

        def answered(data: bytes, at: float) -> None:
            payloads = received.feed(data, at)
            self.packets += [Status() for payload in payloads if payload[0] in STATUS_TYPES]

        super().__init__(upstream, written, answered)

    def commands(self, since: int = 0) -> list[Command]:
        """The robot agent's commands from a position in `packets` on."""
        return [packet for packet in self.packets[since:] if isinstance(packet, Command)]


def moves(command: Command) -> bool:
    """Whether a command requests the wheels to turn."""
    return command.number in (Cmd.VEL, Cmd.RVEL) and command.value != 0


def statuses_until_stop(packets: list[Packet]) -> int:
    """Status packets between the last command to move and the first zero speed after it.

    Raises ValueError without such commands.
    """
    last = max(i for i, p in enumerate(packets) if isinstance(p, Command) and moves(p))
    rest = packets[last + 1 :]
    stop = next(
        (i for i, p in enumerate(rest) if isinstance(p, Command) and p.number == Cmd.VEL), None
    )
    if stop is None:
        raise ValueError("no stop was ordered")
    return sum(isinstance(packet, Status) for packet in rest[:stop])
