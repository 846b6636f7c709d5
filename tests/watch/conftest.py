"""A small society for commands in a terminal, and rehearsals as if they were installed."""

import pytest

from armadico.watch.assistant.tools import REHEARSE, TOOLS
from tests.robot.terminal import environment, router, run, society

__all__ = ["environment", "router", "run", "society"]


@pytest.fixture(autouse=True)
def rehearsals(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tool is offered although the package of rehearsals may be missing."""
    monkeypatch.setitem(TOOLS, REHEARSE.name, REHEARSE)
