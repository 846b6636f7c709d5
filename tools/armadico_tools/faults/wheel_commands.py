"""The speeds that the robot agent orders, out of the bytes that it writes; sans-IO."""

from __future__ import annotations

from typing import Final

from armadico.bridge.p2os.commands import Cmd, decode_command
from armadico.bridge.p2os.packets import Decoder
from armadico_tools.faults.observations import Ordered

STOPS: Final = frozenset({Cmd.STOP, Cmd.E_STOP, Cmd.CLOSE})


class Orders:
    """One robot agent's line to its controller, as the agent writes it."""

    def __init__(self) -> None:
        self._decoder = Decoder()
        self._v = self._w = 0.0

    def feed(self, data: bytes, at: float) -> list[Ordered]:
        """Take bytes at a time, s; the speeds that stand after them, if speeds are in them.

        Of what is written at once only the last counts, as for the controller.
        """
        spoke = False
        for payload in self._decoder.feed(data, at):
            command = decode_command(payload)
            if command.number == Cmd.VEL:
                self._v, spoke = command.si, True
            elif command.number == Cmd.RVEL:
                self._w, spoke = command.si, True
            elif command.number in STOPS or (command.number == Cmd.ENABLE and not command.value):
                self._v = self._w = 0.0
                spoke = True
        return [Ordered(at, self._v, self._w)] if spoke else []
