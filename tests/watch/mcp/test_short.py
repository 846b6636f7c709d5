"""Short answers: a sentence and a few values, at most 1 kB whatever the society is."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.watch.mcp.short import LARGEST, fitted, shortened

LONG = "x" * 500

EVENTS = [{"ago": float(n), "what": f"{n} {LONG}"} for n in range(200)]

LARGE: dict[str, dict[str, Any]] = {
    "where": {
        "connected": True,
        "room": LONG,
        "robot": {
            "v": 0.1,
            "w": 0,
            "speed": LONG,
            "driver": LONG,
            "stopped_by": LONG,
            "battery": LONG,
        },
        "pose": {"x": 1.0, "y": 1.0, "heading_deg": 0.0, "deviation_m": 0.1, "lost_s": 3.0},
        "mission": {
            "number": "5",
            "state": "driving",
            "to_go": 3.0,
            "silent_s": None,
            "note": LONG,
        },
    },
    "map": {"world": LONG, "bounds": [0.0, 0.0, 9.0, 9.0], "picture": [LONG] * 36},
    "places": {"places": [{"name": f"place {n}", "x": 1.0, "y": 2.0} for n in range(500)]},
    "who": {
        "agents": [
            {"name": f"agent-{n}", "instance": LONG, "host": "h", "holds": ["wheels"]}
            for n in range(150)
        ]
    },
    "why": {
        "stands": True,
        "sentences": [LONG] * 9,
        "cause": {"sort": "stop", "who": LONG, "todo": LONG},
        "summary": LONG,
        "findings": [LONG] * 9,
    },
    "history": {"events": EVENTS},
    "missions": {
        "available": [{"name": f"m{n}", "title": LONG} for n in range(50)],
        "board": [
            {"number": "1", "name": LONG, "state": "active", "doing": LONG, "over": False}
            for _ in range(50)
        ],
    },
}


def size(found: object) -> int:
    return len(msgspec.json.encode(found))


@pytest.mark.parametrize("tool", LARGE)
def test_every_tools_answer_is_small_and_all_of_it_is_a_more_away(tool: str) -> None:
    full = LARGE[tool]
    short = shortened(tool, full, more=False)
    assert size(short) <= LARGEST
    assert short["text"]
    assert shortened(tool, full, more=True) == {
        "text": shortened(tool, full, more=True)["text"],
        **full,
    }


def test_the_newest_events_are_kept() -> None:
    short: Any = shortened("history", LARGE["history"], more=False)
    assert short["events"][-1]["ago"] == 199.0
    assert short["left_out"] == 200 - len(short["events"])


@pytest.mark.parametrize("events", [[], EVENTS])
def test_a_history_names_what_may_be_missing_in_it(events: list[Any]) -> None:
    full = {"events": events, "unknown": {"collision": "no sim/truth was received"}}
    text = shortened("history", full, more=False)["text"]
    assert "known of: collision" in str(text)
    assert "Nothing has happened" not in str(text)


def test_what_is_left_out_is_counted() -> None:
    short: Any = shortened("places", LARGE["places"], more=False)
    assert len(short["places"]) + short["left_out"] == 500
    assert short["places"][0]["name"] == "place 0"


VALUES = st.text(max_size=3000) | st.lists(st.text(max_size=80)) | st.integers(-(2**60), 2**60)


@given(st.dictionaries(st.text(max_size=30), VALUES, max_size=8))
def test_whatever_is_answered_is_cut_to_fit(found: dict[str, Any]) -> None:
    assert size(fitted({"text": "It is so.", **found})) <= LARGEST
