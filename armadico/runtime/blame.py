"""Finds the agent that raised an exception, and the lines of its code."""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

from armadico.core.agent import Agent
from armadico.core.config_errors import ConfigError
from armadico.runtime.errors import AgentFailedError, SocietyError

# The packages that call agents. Their lines do not help to find a fault in an agent.
FRAMEWORK: Final = tuple(
    f"armadico.{room}."
    for room in ("core", "mobile", "mesh", "runtime", "launch", "cli", "observe")
)


@contextmanager
def attributed(kind: type[Agent] | None = None) -> Iterator[None]:
    """Raise an agent's exception as AgentFailedError, and others unchanged.

    `kind` is the agent's class while there is no instance yet. A ConfigError is the user's fault
    and stays unchanged, too.
    """
    try:
        yield
    except (SocietyError, ConfigError):
        raise
    except Exception as error:
        text = failure(error, kind)
        if text is None:
            raise
        raise AgentFailedError(text) from error


def failure(error: BaseException, kind: type[Agent] | None = None) -> str | None:
    """Return which agent raised and the lines of its code; None if no agent did.

    If none of its lines is in the traceback (a method with too few arguments, a declaration of the
    wrong type), the text has its class and the framework's line that failed.
    """
    frames = [*traceback.walk_tb(error.__traceback__)]
    kind = next((found for frame, _ in reversed(frames) if (found := _agent(frame))), kind)
    if kind is None:
        return None
    first = next((at for at, (frame, _) in enumerate(frames) if _is_theirs(frame)), -1)
    summary = traceback.StackSummary.extract(iter(frames[first:]))
    for line in summary:
        line.colno = None  # no rows of ^^^
    lines = [*summary.format(), *traceback.format_exception_only(error)]
    if first < 0:
        lines.insert(0, _place(kind))
    return f"{kind.name or kind.__name__} failed:\n{''.join(lines).rstrip()}"


def _is_theirs(frame: FrameType) -> bool:
    return not f"{frame.f_globals.get('__name__', '')}.".startswith(FRAMEWORK)


def _agent(frame: FrameType) -> type[Agent] | None:
    caller = frame.f_locals.get("self")
    return type(caller) if isinstance(caller, Agent) else None


def _place(kind: type[Agent]) -> str:
    try:
        _, line = inspect.getsourcelines(kind)
        return f'  File "{inspect.getsourcefile(kind)}", line {line}, class {kind.__name__}\n'
    except (OSError, TypeError):  # defined in a notebook
        return f"  class {kind.__name__} of {kind.__module__}\n"
