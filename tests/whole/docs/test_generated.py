"""The generated parts are complete, and every reference leads somewhere."""

from __future__ import annotations

from armadico.core import messages
from armadico.core.coordination import TRANSITIONS
from armadico_tools import docs
from armadico_tools.docs_fields import fields_of, ours
from tests.whole.docs.blocks import ROOT


def test_the_protocol_page_has_every_key_message_and_transition() -> None:
    text = docs.filled((ROOT / "docs" / "protocol.md").read_text(encoding="utf-8"))
    for service in ours()[0]:
        assert f"`{service.key.replace('{', '<').replace('}', '>')}`" in text
    for name in ("Cycle", "Ballot", "RobotState", "Claim", "Truth"):
        assert f"\n### {name}\n" in text
    for event in {event for _, event in TRANSITIONS}:
        assert event.value in text


def test_fields_are_in_the_order_of_the_wire_with_their_ranges() -> None:
    fields = fields_of(messages.Claim)
    assert [f.name for f in fields] == list(messages.Claim.__struct_fields__)
    assert fields[3].type == "float, 0 to 1 or null"
    assert fields[4].default == "false"
    assert fields[5].type == "array of up to 64 (float, -1e6 to 1e6) or bytes, up to 65,536"
    beside = {field.name: field.meaning for field in fields_of(messages.Description)}
    assert beside["cycle_s"] == "s from one status packet to the next"
    below = {field.name: field.meaning for field in fields_of(messages.Card)}
    assert "owns" in below["owns"]
