"""The messages by which the interface agent passes orders on to whoever does missions."""

from __future__ import annotations

from typing import Annotated, ClassVar, Final

from msgspec import Meta
from msgspec.structs import replace

from armadico.core.messages import Bits64, Label, Message, Name, Share
from armadico.core.services import query
from armadico.mobile.errand import Order
from armadico.mobile.messages import MissionReply, Terms

NEAR_M: Final = 0.12
"""Default of the interface's `near_m`: a robot so near to a goal is there, m."""


class MissionOrder(Order, frozen=True):
    """Orders a mission from the interface agent; `text` is its TOML, deflated (zlib).

    `mission` is its number, drawn at random by the sender: a repeated order is the same mission,
    and it can be cancelled before any reply. 0: the interface agent draws one.
    """

    name: Name
    text: Annotated[bytes, Meta(max_length=16_384)]
    priority: Share | None = None  # null: the mission's own
    by: Label = ""
    mission: Bits64 = 0
    terms: Terms | None = None  # of all its paths

    appended: ClassVar[int] = 1

    def numbered(self, number: int) -> MissionOrder:
        """Return the order with its number, by which a refused one is withdrawn."""
        return replace(self, mission=number)

    def withdrawal(self) -> MissionCancel:
        """Return the message that cancels it."""
        return MissionCancel(self.mission, self.by)


class MissionProposal(Message, frozen=True):
    """The interface agent proposes a mission to mission planning (use case 1 of thesis 3.2)."""

    order: MissionOrder


class MissionCancel(Message, frozen=True):
    """Requests the interface agent to cancel a mission or goal; 0: all missions, and no goal."""

    mission: Bits64
    by: Label = ""


class MissionWithdrawal(Message, frozen=True):
    """The interface agent passes a cancellation on to mission planning."""

    cancel: MissionCancel


query(MissionOrder, "mission/order", MissionReply, "order a mission")
query(MissionCancel, "mission/cancel", MissionReply, "cancel a mission")
query(MissionProposal, "mission/proposal", MissionReply, "the interface agent passes an order on")
query(
    MissionWithdrawal,
    "mission/withdrawal",
    MissionReply,
    "the interface agent passes a cancellation on",
)
