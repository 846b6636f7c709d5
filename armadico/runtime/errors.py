"""The errors of a society, for commands, scripts and notebooks.

The module imports nothing, so that `--help` is fast. Each text is one line, or ends with the last
output of a process, and has the remedy. Commands print it unchanged.
"""

from __future__ import annotations


class SocietyError(RuntimeError):
    """A request to a society failed; the message has the reason and the remedy."""


class AbsentError(SocietyError):
    """No agent that provides the service is alive."""

    def __init__(self, what: str, namespace: str | None = None) -> None:
        super().__init__(what, namespace)  # unpickled from these, from a worker process

    def __str__(self) -> str:
        what, namespace = self.args
        if namespace is None:
            return str(what)
        return (
            f"{what} (namespace {namespace!r}); `armadico ps` lists alive agents; --namespace and"
            " --connect choose where to look"
        )


class MissionRefusedError(SocietyError):
    """The mission was refused."""

    def __init__(self, reason: str) -> None:
        self.reason = reason  # the interface agent's text
        super().__init__(reason)

    def __str__(self) -> str:
        return f"the mission was refused: {self.reason}"


class MissionReplacedError(SocietyError):
    """Another mission has replaced this one."""


class StopError(SocietyError):
    """The robot agent did not confirm the stop or the release."""


class ParameterError(SocietyError):
    """A parameter was not changed: it does not exist, or the value is not allowed."""


class AgentFailedError(SocietyError):
    """An agent's own code raised; the message ends with its traceback."""


class RunFailedError(SocietyError):
    """A run cannot begin or continue."""
