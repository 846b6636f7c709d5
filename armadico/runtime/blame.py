"""Whose exception it is, and where in their code: what people are told of an agent that raises."""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

from armadico.config.errors import ConfigError
from armadico.core.agent import Agent
from armadico.runtime.errors import AgentFailedError, SocietyError

FRAMEWORK: Final = tuple(
    f"armadico.{room}."
    for room in ("core", "mobile", "mesh", "runtime", "launch", "cli", "observe")
)
"""What calls an agent: of no use to whoever looks for the fault in it."""


@contextmanager
def blaming(kind: type[Agent] | None = None) -> Iterator[None]:
    """An exception of an agent comes out as AgentFailedError, all others as they are.

    `kind` is whose it is where no agent has been made yet. What an agent cannot be configured with
    is its user's fault, and says what would be right.
    """
    try:
        yield
    except (SocietyError, ConfigError):
        raise
    except Exception as error:
        told = failure(error, kind)
        if told is None:
            raise
        raise AgentFailedError(told) from error


def failure(error: BaseException, kind: type[Agent] | None = None) -> str | None:
    """The agent that raised, and the lines of its code that led there; None if it was none.

    Where none of its lines did (a method with too few arguments, a declaration of the wrong type),
    its class is named, and the line of ours that stumbled over it.
    """
    frames = [*traceback.walk_tb(error.__traceback__)]
    kind = next((who for frame, _ in reversed(frames) if (who := _agent(frame))), kind)
    if kind is None:
        return None
    first = next((at for at, (frame, _) in enumerate(frames) if _is_theirs(frame)), -1)
    summary = traceback.StackSummary.extract(iter(frames[first:]))
    for line in summary:
        line.colno = None  # a row of ^^^ takes the place of a line that says something
    said = [*summary.format(), *traceback.format_exception_only(error)]
    if first < 0:
        said.insert(0, _place(kind))
    return f"{kind.name or kind.__name__} failed:\n{''.join(said).rstrip()}"


def _is_theirs(frame: FrameType) -> bool:
    return not f"{frame.f_globals.get('__name__', '')}.".startswith(FRAMEWORK)


def _agent(frame: FrameType) -> type[Agent] | None:
    who = frame.f_locals.get("self")
    return type(who) if isinstance(who, Agent) else None


def _place(kind: type[Agent]) -> str:
    try:
        _, line = inspect.getsourcelines(kind)
        return f'  File "{inspect.getsourcefile(kind)}", line {line}, class {kind.__name__}\n'
    except (OSError, TypeError):  # of a notebook
        return f"  class {kind.__name__} of {kind.__module__}\n"
