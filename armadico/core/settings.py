"""The parameters of one agent that are changed while it runs.

A change outlives the process: it is a latched state (`messages.Tuning`), so that every agent stores
it and a restarted or second instance adopts it.
"""

from __future__ import annotations

from typing import Any, Final

from armadico.core import changeable
from armadico.core import messages as m
from armadico.core.desk import Desk
from armadico.core.outgoing import WARNING

MOST_SETTINGS: Final = 256  # settings of one agent that are replicated
RESTORED: Final = "those who remember"  # the `by` of a change restored after a restart


class Settings:
    """Applies, shares and adopts changes of an agent's parameters."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._agent = desk.agent
        self._begun = self._agent.p  # at the start
        self._set: dict[str, str] = {}  # by this or an earlier instance: JSON by name
        changeable.allowed(type(self._begun), self._agent.changeable)  # raises for a wrong name

    def tune(self, request: m.ParametersRequest) -> m.ParametersReply:
        """Apply all requested changes or none; return the changeable parameters afterwards."""
        agent, refusal = self._agent, ""
        if request.change:
            try:
                self._apply(request.change, request.by or "an unknown program")
            except ValueError as error:
                refusal = m.line(str(error))
            else:
                self._set |= {setting.name: setting.json for setting in request.change}
                self._share()
        rows = changeable.listed(agent.p, self._begun, agent.changeable)
        fixed = changeable.fixed(agent.p, agent.changeable)
        return m.ParametersReply(agent.instance, rows, refusal, fixed)

    def adopt(self, tuning: m.Tuning) -> None:
        """Apply the settings that an earlier or another instance of this agent received."""
        name = self._agent.name
        mine = {e.setting.name: e.setting.json for e in tuning.settings if e.agent == name}
        for name, value in mine.items():
            if self._set.get(name) == value:
                continue
            self._set[name] = value
            try:
                self._apply((m.Setting(name, value),), RESTORED)
            except ValueError as error:  # for example by an instance of another version
                self._desk.log(f"not set as before: {error}", WARNING)
        if set(self._set) - set(mine):  # the publisher did not have them
            self._share()

    def _apply(self, change: tuple[m.Setting, ...], by: str) -> None:
        """Change parameters and publish it. Raises ValueError; nothing is changed then."""
        agent, desk = self._agent, self._desk
        before: Any = agent.p  # the agent's hook names its type
        agent.p = changeable.changed(before, agent.changeable, change)
        try:
            agent.on_parameters(before)
        except ValueError:
            agent.p = before
            raise
        for name, old, new in changeable.differences(before, agent.p, tuple(agent.changeable)):
            desk.publish(m.ParameterChange(agent.name, agent.instance, name, old, new, by))
            desk.log(f"{name} = {new}, before {old}: changed by {by}")

    def _share(self) -> None:
        """Publish this agent's settings as a latched state."""
        desk, agent = self._desk, self._agent
        known = desk.memory.newest(m.Tuning, agent.name) or m.Tuning(0, 0)
        mine = tuple(m.AgentSetting(agent.name, m.Setting(*each)) for each in self._set.items())
        if known.settings == mine:
            return
        by = agent.rng.getrandbits(63)
        desk.publish(m.Tuning(m.next_count(known.counter), by, mine[-MOST_SETTINGS:]))
