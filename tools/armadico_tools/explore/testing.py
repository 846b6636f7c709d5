"""A counterexample as a test, ready to be put into a file."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from armadico_tools.explore.joining import Joining, JoiningRun
from armadico_tools.explore.world import KINDS, Setup

if TYPE_CHECKING:
    from armadico_tools.explore.search import Counterexample


def as_test(found: Counterexample) -> str:
    """A test that fails for as long as the promise is broken."""
    run = found.run
    steps = "".join(f"        {n}: {dict(step)!r},\n" for n, step in sorted(run.steps.items()))
    more = f", loop={run.loop}" if run.loop else ""
    more += f", patience={run.patience}" if run.patience is not None else ""
    return (
        "from armadico_tools.explore.replay import Run, replay\n"
        "from armadico_tools.explore.world import Setup\n\n\n"
        f"def test_{_name(found.promise)}() -> None:\n"
        f'    """{found.promise}: {_line(found.how)}."""\n'
        f"    setup = {_setup(run.setup)}\n"
        f"    steps = {{\n{steps}    }}\n"
        f"    assert replay(Run(setup, steps, cycles={run.cycles}{more})) == []\n"
    )


def joining_as_test(how: str, run: JoiningRun) -> str:
    """The same, of who may join."""
    picks = "".join(f"        {what!r}: {way!r},\n" for what, way in run.picks.items())
    setup: Joining = run.setup
    return (
        "from armadico_tools.explore.joining import Joining, JoiningRun, rejoin\n\n\n"
        f"def test_{_name(how.partition(':')[0])}() -> None:\n"
        f'    """{_line(how)}."""\n'
        f"    setup = {setup!r}\n"
        f"    picks = {{\n{picks}    }}\n"
        "    assert rejoin(JoiningRun(setup, picks)) == []\n"
    )


def _setup(setup: Setup) -> str:
    """Only what is not as it is by itself, and matters in one run."""
    more = f", stagger={setup.stagger!r}" if setup.stagger else ""
    more += ", apart=True" if setup.apart else ""
    more += f", kinds={setup.kinds!r}" if setup.kinds != KINDS else ""
    return f"Setup({setup.bids!r}{more})"


def _name(promise: str) -> str:
    return re.sub(r"\W+", "_", promise.lower()).strip("_")


def _line(text: str) -> str:
    return re.sub(r"[^ -~]|[\\\"]", " ", text)[:80]
