"""What is known of one robot's society by whoever serves its page (sans-IO)."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any, Final

from armadico.agents.supervision.messages import HostShare, KeptState
from armadico.core.messages import ParameterChange, ParametersReply, plain
from armadico.core.services import service_of
from armadico.observe.view import View

SHARE_S: Final = 5.0
"""A host that has said nothing for so long keeps nobody up."""


@dataclass(frozen=True)
class KeptAgent:
    """An agent that a host keeps up, as its wakeup agent says."""

    agent: str
    pid: int
    host: str
    wakeup: str
    state: str
    why: str


class Known:
    """A view of the society, what its hosts keep up and could, and what may be changed of it.

    Attributes:
        view: All that any watcher knows.
        parameters: By instance, what may be changed of it.
    """

    def __init__(self, helpers: Collection[str] = ()) -> None:
        """Nothing is known yet; `helpers` can be started beside the page, where no host would."""
        self.view = View()
        self.parameters: dict[str, list[dict[str, Any]]] = {}
        self._helpers = tuple(helpers)
        self._shares: dict[str, tuple[HostShare, float]] = {}

    def take(
        self, key: str, message: HostShare | ParametersReply | ParameterChange, t: float
    ) -> None:
        """What a host or an agent says at t (s), or that a parameter was changed, by anybody.

        A host is asked by the name that it says, so that has to be the one of its key.
        """
        match message:
            case HostShare():
                if key != service_of(HostShare).key_for(instance=message.instance):
                    return
                self._shares[message.instance] = (message, t)
            case ParametersReply():
                self.parameters[message.instance] = [*map(plain, message.parameters)]
            case ParameterChange():
                for row in self.parameters.get(message.instance, ()):
                    if row["name"] == message.name:
                        row["json"] = message.json

    def token(self, instance: str, *, there: bool, t: float) -> None:
        """A liveliness token came or went."""
        self.view.token(instance, there=there, t=t)
        if not there:
            self.parameters.pop(instance, None)
            self._shares.pop(instance, None)

    def kept(self, t: float) -> Iterator[KeptAgent]:
        """The agents that hosts keep up, alive or not."""
        for instance, (share, at) in self._shares.items():
            if t - at > SHARE_S or share.leaving:
                continue
            for process in share.kept:
                if process.state is not KeptState.ENDED:
                    for name in process.agents:
                        yield KeptAgent(
                            name,
                            process.pid,
                            share.host,
                            instance,
                            process.state.value,
                            process.why,
                        )

    def could(self, t: float) -> dict[str, str]:
        """Agents that a host would start, and its wakeup agent's instance; empty: the page."""
        found = dict.fromkeys(self._helpers, "")
        for instance, (share, at) in self._shares.items():
            if t - at <= SHARE_S and not share.leaving:
                found |= dict.fromkeys(share.can, instance)
        return {name: who for name, who in found.items() if name not in self.view.names}
