"""What a society did not do: one family of errors for commands, scripts and notebooks.

It imports nothing, so that `--help` can do with it. Each text is one line, or ends with the last
words of a process, and says what to do; a command prints it as it is.
"""

from __future__ import annotations


class SocietyError(RuntimeError):
    """What was asked of a society was not done; the message says why, and what to do."""


class AbsentError(SocietyError):
    """No agent that could do it is alive."""

    def __init__(self, what: str, namespace: str | None = None) -> None:
        super().__init__(what, namespace)  # a worker's error is made again from these

    def __str__(self) -> str:
        what, namespace = self.args
        if namespace is None:
            return str(what)
        return (
            f"{what} (namespace {namespace!r}); `armadico ps` lists alive agents; --namespace and"
            " --connect choose where to look"
        )


class MissionRefusedError(SocietyError):
    """Nobody took the mission on."""

    def __init__(self, reason: str) -> None:
        self.reason = reason  # the interface agent's own words
        super().__init__(reason)

    def __str__(self) -> str:
        return f"the mission was refused: {self.reason}"


class MissionReplacedError(SocietyError):
    """Somebody has sent the robot elsewhere meanwhile."""


class StopError(SocietyError):
    """The robot is not stopped, or not released, as far as is known."""


class ParameterError(SocietyError):
    """A parameter was not changed: there is no such one, or it may not be that."""


class AgentFailedError(SocietyError):
    """An agent's own code raised; the message ends as its traceback does."""


class RunFailedError(SocietyError):
    """A run cannot begin or go on."""
