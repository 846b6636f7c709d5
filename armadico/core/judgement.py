"""Yes, no or unknown: what a run, a log, a map or a check concludes.

*Unknown never passes.* Silence is no evidence: a robot whose collisions nobody counted has not
driven without one. Each conclusion other than yes has a reason, and unknown has a cure too: how
to make it known.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

UNKNOWN_EXIT: Final = 3
"""Exit code of a command whose result is unknown; 0 is yes and 1 no."""


class Answer(StrEnum):
    YES = "yes"
    NO = "no"
    UNKNOWN = "unknown"


_EXIT: Final = {Answer.YES: 0, Answer.NO: 1, Answer.UNKNOWN: UNKNOWN_EXIT}
_RANK: Final = {Answer.YES: 0, Answer.UNKNOWN: 1, Answer.NO: 2}


# No Struct: --help, which knows the exit code, imports no msgspec.
@dataclass(frozen=True, slots=True)
class Judgement:
    """One conclusion, made by `yes`, `no` or `unknown`.

    Attributes:
        answer: Yes, no or unknown.
        reason: Why; empty for a plain yes.
        cure: What to do: how to repair it, or how to make it known. May be empty.
    """

    answer: Answer
    reason: str = ""
    cure: str = ""

    def __bool__(self) -> bool:
        # Either value would be wrong for unknown: the caller has to name the answer that it wants.
        raise TypeError("a judgement has three answers: use `passed`, or compare `answer`")

    def __str__(self) -> str:
        return f"{self.answer}: {self.reason}" if self.reason else str(self.answer)

    @property
    def passed(self) -> bool:
        """Whether the answer is yes."""
        return self.answer is Answer.YES

    @property
    def exit_code(self) -> int:
        """0 for yes, 1 for no, `UNKNOWN_EXIT` for unknown."""
        return _EXIT[self.answer]


def yes(reason: str = "") -> Judgement:
    return Judgement(Answer.YES, reason)


def no(reason: str, cure: str = "") -> Judgement:
    return Judgement(Answer.NO, reason, cure)


def unknown(reason: str, cure: str = "") -> Judgement:
    return Judgement(Answer.UNKNOWN, reason, cure)


def whether(passed: bool | None, reason: str, cure: str = "") -> Judgement:
    """The judgement of a measured value, where None is unknown; `reason` is for no and unknown."""
    if passed is None:
        return unknown(reason, cure)
    return yes() if passed else no(reason, cure)


def all_of(judgements: Iterable[Judgement]) -> Judgement:
    """Yes if all are yes. No if any is no: more knowledge would not change it. Else unknown.

    The reasons and cures of those that gave the answer are joined. Without any judgement nothing
    is known.
    """
    found = list(judgements)
    if not found:
        return unknown("nothing was judged")
    answer = max((each.answer for each in found), key=_RANK.__getitem__)
    deciding = [each for each in found if each.answer is answer]
    reasons = dict.fromkeys(each.reason for each in deciding if each.reason)
    cures = dict.fromkeys(each.cure for each in deciding if each.cure)
    return Judgement(answer, "; ".join(reasons), "; ".join(cures))
