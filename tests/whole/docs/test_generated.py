"""The documents' generated parts say what the code says, and every reference leads somewhere."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from armadico.core import messages
from armadico.core.coordination import TRANSITIONS
from armadico_tools import docs
from armadico_tools.docs_fields import fields_of, ours
from tests.whole.docs.blocks import ROOT, documents

LINK = re.compile(r"(?<!`)\[[^\]\n]*\]\(([^)\s]+)\)")
PATH = re.compile(
    r"`((?:armadico|agents|bridge|tests|tools|configs|docs)/[\w./-]+\.(?:py|md|toml))`"
)
TEST = re.compile(r"`(test_\w+)`")


def test_no_document_is_stale() -> None:
    assert not [*docs.stale()], "python -m armadico_tools.docs writes them again"


def test_every_marker_of_a_part_is_one_that_is_written() -> None:
    """One that the pattern passes over would be stale for ever."""
    for path in documents():
        text = path.read_text(encoding="utf-8")
        found = [match[2] for match in docs.PART.finditer(text)]
        assert found == re.findall(r"^<!-- generated: (.*) -->$", text, re.MULTILINE), path


def test_the_protocol_page_has_every_key_message_and_transition() -> None:
    text = (ROOT / "docs" / "protocol.md").read_text(encoding="utf-8")
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


@pytest.mark.parametrize("path", documents(), ids=lambda path: path.name)
def test_every_link_leads_somewhere(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    for target in LINK.findall(text):
        place, _, anchor = target.partition("#")
        if place.startswith(("http://", "https://")):
            continue
        file = path.parent / place if place else path
        assert file.exists(), target
        if anchor and file.suffix == ".md":
            assert anchor in _anchors(file.read_text(encoding="utf-8")), target


@pytest.mark.parametrize("path", documents(), ids=lambda path: path.name)
def test_every_file_that_is_named_is_there(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    missing = [name for name in PATH.findall(text) if not (ROOT / name).exists()]
    assert not missing


@pytest.mark.parametrize("path", documents(), ids=lambda path: path.name)
def test_every_test_that_is_named_is_there(path: Path) -> None:
    named = set(TEST.findall(path.read_text(encoding="utf-8")))
    there = "\n".join(file.read_text(encoding="utf-8") for file in ROOT.glob("tests/**/*.py"))
    missing = {name for name in named if f"def {name}(" not in there}
    assert not missing


def test_every_dependency_has_its_reason() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    row = r"^\| ([\w-]+)(?: \(extra `\w+`\))? \| [^|]+ \| [^|]+ \| [^|]+ \|$"
    rows = set(re.findall(row, text, re.MULTILINE))
    with (ROOT / "pyproject.toml").open("rb") as file:
        project = tomllib.load(file)["project"]
    needed = [*project["dependencies"], *project["optional-dependencies"]["plot"]]
    assert {re.split(r"[<>=]", need)[0] for need in needed} <= rows


def _anchors(text: str) -> set[str]:
    heads = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head).strip().lower().replace(" ", "-") for head in heads}
