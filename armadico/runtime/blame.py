"""Whose exception it is, and where in their code: what people are told of an agent that raises."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

from armadico.config.errors import ConfigError
from armadico.core.agent import Agent
from armadico.runtime.errors import AgentFailedError, SocietyError

FRAMEWORK: Final = tuple(
    f"armadico.{room}." for room in ("core", "mesh", "runtime", "launch", "cli", "observe")
)
"""What calls an agent: of no use to whoever looks for the fault in it."""


@contextmanager
def blaming() -> Iterator[None]:
    """An exception in an agent's own code comes out as AgentFailedError, all others as they are.

    What an agent cannot be configured with is its user's fault, and says what would be right.
    """
    try:
        yield
    except (SocietyError, ConfigError):
        raise
    except Exception as error:
        told = failure(error)
        if told is None:
            raise
        raise AgentFailedError(told) from error


def failure(error: BaseException) -> str | None:
    """The agent that raised, and the lines of its code that led there; None if it was none."""
    frames = [*traceback.walk_tb(error.__traceback__)]
    first = next((at for at, (frame, _) in enumerate(frames) if _is_theirs(frame)), None)
    who = next((who for frame, _ in reversed(frames) if (who := _agent(frame))), None)
    if first is None or who is None:
        return None
    summary = traceback.StackSummary.extract(iter(frames[first:]))
    for line in summary:
        line.colno = None  # a row of ^^^ takes the place of a line that says something
    said = [*summary.format(), *traceback.format_exception_only(error)]
    return f"{who} failed:\n{''.join(said).rstrip()}"


def _is_theirs(frame: FrameType) -> bool:
    return not f"{frame.f_globals.get('__name__', '')}.".startswith(FRAMEWORK)


def _agent(frame: FrameType) -> str | None:
    who = frame.f_locals.get("self")
    return who.name if isinstance(who, Agent) else None
