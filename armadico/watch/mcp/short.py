"""Answers that are small: one sentence, and the few values that a program decides by (sans-IO).

A language model reads each answer whole, and pays for it. All that is known is a `more` away.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, cast

import msgspec

from armadico.core.messages import line
from armadico.observe.jsons import Json, JsonObject

LARGEST: Final = 1000  # bytes of a short answer as JSON

SHORTEST: Final = 24  # characters that are left of a text before lists are cut

LEFT_OUT: Final = "left_out"

Full = Mapping[str, Any]


def shortened(tool: str, full: Full, *, more: bool) -> JsonObject:
    """Return the answer of a tool that only reads: its sentence, and all of it or little."""
    text = line(SENTENCES[tool](full))
    if more:
        return {"text": text, **full}
    few = FEW[tool](full) if tool in FEW else full
    return fitted({"text": text, **few})


def fitted(found: Mapping[str, Json]) -> JsonObject:
    """Return an object of at most `LARGEST` bytes as JSON, whatever its lists and texts are.

    The longest list loses its last elements, and `left_out` counts them; then long texts are cut.
    """
    cut = dict(found)
    while (over := len(msgspec.json.encode(cut)) - LARGEST) > 0:
        lists = {k: v for k, v in cut.items() if isinstance(v, list | tuple) and v}
        texts = {k: v for k, v in cut.items() if isinstance(v, str) and len(v) > SHORTEST}
        sizes = {k: len(msgspec.json.encode(v)) for k, v in (lists | texts).items()}
        if not sizes:
            return {"text": "the answer is too large to be shortened: ask for more"}
        name = max(sizes, key=lambda each: sizes[each])
        if name in lists:
            drop = max(1, len(lists[name]) * over // (2 * sizes[name]))
            cut[name] = lists[name][:-drop]
            cut[LEFT_OUT] = cast("int", cut.get(LEFT_OUT, 0)) + drop
        else:
            keep = max(len(texts[name]) - over - 3, SHORTEST)
            cut[name] = f"{texts[name][:keep]}..."[: len(texts[name]) - 1]
    return cut


# Sentences ----------------------------------------------------------------------------------


def _where(full: Full) -> str:
    robot, pose, goal = full["robot"], full["pose"], full["mission"]
    if robot is None and pose is None:
        return "Nothing was received from the robot yet."
    if pose is None:
        at = "Where the robot is, is not known"
    else:
        room = f" in {full['room']}" if full.get("room") else ""
        lost = f", lost for {pose['lost_s']} s" if pose["lost_s"] is not None else ""
        at = f"The robot is at ({pose['x']:.2f}, {pose['y']:.2f}){room}, heading"
        at += f" {pose['heading_deg']:.0f} deg{lost}"
    if robot is None:
        return f"{at}; its state was not received."
    if robot["stopped_by"] is not None:
        does = f"stopped by {robot['stopped_by']}"
    else:
        driver = f", driven by {robot['driver']}" if robot["driver"] else ""
        does = (
            f"{robot['speed'] if abs(robot['v']) + abs(robot['w']) > 0.01 else 'at rest'}{driver}"
        )
    to = ""
    if goal is not None and goal["state"] == "driving":
        note = f" ({goal['note']})" if goal["note"] else ""
        ago = "" if goal["silent_s"] is None else f"{goal['silent_s']:.0f} s ago "
        to = f"; {ago}{goal['to_go']:.1f} m to its goal{note}"
    known = "" if full["connected"] else " This is its last report: it is not connected now."
    return f"{at}, {does}{to}.{known}"


def _map(full: Full) -> str:
    if "bounds" not in full:
        return cast("str", full["note"])
    x1, y1, x2, y2 = full["bounds"]
    what = f"The world {full['world']}" if "world" in full else "What is sensed around the robot"
    return (
        f"{what}: x {x1:g} to {x2:g} m, y {y1:g} to {y2:g} m. The resource armadico://map is its"
        " picture; `places` has the names."
    )


def _places(full: Full) -> str:
    places = full["places"]
    if not places:
        return cast("str", full.get("note") or "No place of this world has a name.")
    return f"{len(places)} places: {', '.join(place['name'] for place in places)}."


def _who(full: Full) -> str:
    agents = full["agents"]
    names = sorted({agent["name"] for agent in agents})
    return (
        f"{len(agents)} agents are alive: {', '.join(names)}." if agents else "No agent is alive."
    )


def _why(full: Full) -> str:
    sentences = full.get("sentences") or [full.get("note", "nothing is known")]
    cause = full.get("cause")
    todo = f" -> {cause['todo']}" if cause and cause["todo"] else ""
    return " ".join(sentences) + todo


def _history(full: Full) -> str:
    events = full["events"]
    unknown = ", ".join(full.get("unknown") or ())
    text = f"The last {len(events)} events, newest last." if events else "Nothing has happened."
    if unknown and not events:
        text = "No event is known."
    return f"{text} Some may not be known of: {unknown}." if unknown else text


def _missions(full: Full) -> str:
    going = [each for each in full["board"] if not each["over"]]
    names = ", ".join(each["name"] for each in full["available"]) or "none"
    under = "; ".join(f"{each['name']} {each['state']}" for each in going) or "none"
    return f"Missions that can be ordered: {names}. Ordered and not over: {under}."


SENTENCES: Final[Mapping[str, Callable[[Full], str]]] = {
    "where": _where,
    "map": _map,
    "places": _places,
    "who": _who,
    "why": _why,
    "history": _history,
    "missions": _missions,
}


# Values -------------------------------------------------------------------------------------


def _few_where(full: Full) -> Full:
    robot, pose, goal = full["robot"], full["pose"], full["mission"]
    few: dict[str, Any] = {"connected": full["connected"]}
    if pose is not None:
        few |= {name: pose[name] for name in ("x", "y", "heading_deg", "deviation_m", "lost_s")}
        few["room"] = full.get("room")
    if robot is not None:
        few |= {name: robot[name] for name in ("v", "driver", "stopped_by", "battery")}
    if goal is not None:
        few["goal"] = {
            name: goal[name] for name in ("number", "state", "to_go", "silent_s", "note")
        }
    return few


def _few_map(full: Full) -> Full:
    return {name: full[name] for name in ("world", "bounds") if name in full}


def _few_who(full: Full) -> Full:
    return {
        "agents": [
            {"name": agent["name"], "host": agent.get("host", "")}
            | ({"holds": agent["holds"]} if agent.get("holds") else {})
            for agent in full["agents"]
        ]
    }


def _few_why(full: Full) -> Full:
    few: dict[str, Any] = {"stands": full["stands"]} if "stands" in full else {}
    if full.get("cause"):
        few["cause"] = {name: full["cause"][name] for name in ("sort", "who")}
    if "summary" in full:
        few["summary"] = full["summary"]
    if full.get("contests"):
        few["wheels"] = next(
            (
                {"obeyed": contest["obeyed"], "utility": contest["utility"]}
                for contest in full["contests"]
                if contest["resource"] == "wheels"
            ),
            None,
        )
    return few


def _few_history(full: Full) -> Full:
    """The newest events that have room; a long one is cut."""
    events: Sequence[Any] = full["events"]
    few = [{"ago": each["ago"], "what": each["what"][:160]} for each in events]
    while len(msgspec.json.encode(few)) > LARGEST - 150:
        few = few[1 + len(few) // 8 :]
    return {"events": few, LEFT_OUT: len(events) - len(few)}


def _few_missions(full: Full) -> Full:
    board = [
        {name: each[name] for name in ("number", "name", "state", "doing")}
        for each in reversed(full["board"])
    ]
    return {"available": [each["name"] for each in full["available"]], "board": board}


FEW: Final[Mapping[str, Callable[[Full], Full]]] = {
    "where": _few_where,
    "map": _few_map,
    "who": _few_who,
    "why": _few_why,
    "history": _few_history,
    "missions": _few_missions,
}
