"""A small society for commands in a terminal, and the tool of rehearsals."""

import pytest

from armadico.watch.assistant.tools import REHEARSE, TOOLS
from tests.robot.terminal import environment, router, run, society

__all__ = ["environment", "router", "run", "society"]


@pytest.fixture
def rehearsals(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tool as if the package of rehearsals were installed, which may be missing."""
    monkeypatch.setitem(TOOLS, REHEARSE.name, REHEARSE)
