"""What the packets of a tapped line say about the wheels."""

from __future__ import annotations

from armadico.bridge.p2os.commands import Cmd, Command
from armadico_tools.faults.serial_tap import Packet, Status


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
