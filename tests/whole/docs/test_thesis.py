"""The page on the thesis names what the set `thesis` sets, and where it departs."""

from __future__ import annotations

import re

from armadico.config.parameters import load_set
from tests.whole.docs.blocks import ROOT

PAGE = ROOT / "docs" / "thesis.md"
HEADINGS = ("### What the set sets", "### Where it departs")
SETTING = re.compile(r"`([a-z_]+(?:\.[a-z_]+)+=[^`]+)`")
PLACE = re.compile(r"`([\w/]+\.py):(\w+)`")
SECTION = re.compile(r"^\d+\.\d+|^none")


def rows(heading: str) -> list[list[str]]:
    """The table under a heading, without its head."""
    text = PAGE.read_text(encoding="utf-8")
    part = text.partition(f"{heading}\n")[2].partition("\n#")[0]
    lines = [line.strip("| ").split(" | ") for line in part.splitlines() if line.startswith("| ")]
    return lines[2:]


def test_the_page_names_what_the_set_sets_and_nothing_else() -> None:
    there = {
        f"{agent}.{setting}" for agent, given in load_set("thesis").items() for setting in given
    }
    named = [s for row in rows(HEADINGS[0]) for s in SETTING.findall(row[-1])]
    assert sorted(named) == sorted(there)


def test_each_departure_names_the_section_and_the_code_that_departs() -> None:
    departures = rows(HEADINGS[1])
    assert len(departures) >= 12
    for row in departures:
        assert SECTION.match(row[0]), row
        places = PLACE.findall(row[-1])
        assert places, row
        for path, name in places:
            text = (ROOT / path).read_text(encoding="utf-8")
            assert re.search(rf"^\s*(?:def |class )?{name}\b[^\n]*[:=(]", text, re.MULTILINE), row
