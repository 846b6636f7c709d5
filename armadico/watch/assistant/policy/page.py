"""Requests of programs that wait for a person, on the control page (sans-IO)."""

from __future__ import annotations

from typing import Any, Final

from armadico.core.messages import Message, Name
from armadico.observe.page_part import Desk, Part
from armadico.observe.page_requests import Asked
from armadico.watch.assistant.policy.messages import ApprovalAnswer, Approvals, Choice

STALE_S: Final = 3.0
"""What waits is published each second; without an assistant agent nothing waits."""


class Approve(Asked, frozen=True, tag="approve"):
    """Answer a request of a program."""

    code: Name
    choice: Choice


class Waiting(Part):
    """Shows what waits for a person, and passes answers on."""

    requests = (Approve,)
    queries = (ApprovalAnswer,)

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self._known: tuple[Approvals, float] | None = None

    def receive(self, key: str, message: Message, t: float) -> None:  # noqa: ARG002
        if isinstance(message, Approvals):
            self._known = message, t

    def request(self, browser: str, request: Approve, t: float) -> None:  # noqa: ARG002
        answer = ApprovalAnswer(request.code, request.choice, browser)
        self.desk.query(browser, request.id, answer, lambda reply: str(reply.text))

    def show(self, parts: dict[str, Any], t: float) -> None:
        known, at = self._known or (Approvals(), t)
        parts["approvals"] = [
            {
                "code": each.code,
                "by": each.request.asker,
                "what": f"{each.request.tool} {each.place or each.request.text}",
                "why": each.why,
                "left": round(each.left_s),
                "goal": [*each.goal],
            }
            for each in (known.waiting if t - at < STALE_S else ())
        ]
