"""What a plug-in promises, as checks that a third party runs in its own tests.

    from armadico.contracts import RobotContract

    class TestMyRobot(RobotContract):
        profile = "my-robot"

pytest then collects each check as a test of its own. `judge` returns the judgement of each, and
`python -m armadico.contracts robot my-robot` prints them. A check whose answer is unknown does not
pass: what could not be measured has not been kept.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

from armadico.core.judgement import Judgement, no


class Contract:
    """The checks of one kind of plug-in: its methods `check_...`, each a Judgement."""

    _tests: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls, **rest: object) -> None:
        """Add a test for pytest for each check of the class."""
        super().__init_subclass__(**rest)
        for name, check in list(vars(cls).items()):
            if name.startswith("check_"):
                setattr(cls, name.replace("check_", "test_", 1), _test(name, check.__doc__))

    @classmethod
    def checks(cls) -> tuple[str, ...]:
        """The names of the checks, those of the base class first."""
        found = (name for each in reversed(cls.__mro__) for name in vars(each))
        return tuple(dict.fromkeys(name for name in found if name.startswith("check_")))

    def judge(self) -> dict[str, Judgement]:
        """Every check's judgement by its name, such as "stops"."""
        return {name.removeprefix("check_"): judged(getattr(self, name)) for name in self.checks()}

    def unchecked(self) -> tuple[str, ...]:
        """What no check judges, for people, with what was seen of it."""
        return ()


def judged(check: Callable[[], Judgement]) -> Judgement:
    """The judgement of a check; "no" with the file and line if it raises."""
    try:
        return check()
    except Exception as error:  # a plug-in may raise anything
        at = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(at.filename).name}, line {at.lineno}"
        return no(f"{type(error).__name__}: {error} ({where})")


def _test(name: str, doc: str | None) -> Callable[[Contract], None]:
    def test(self: Contract) -> None:
        judgement = judged(getattr(self, name))
        assert judgement.passed, f"{judgement}. {judgement.cure}".rstrip(" .")

    test.__doc__ = doc
    return test
