"""A view as dictionaries for JSON: for `ps`, `top`, the page and the MCP server (sans-IO).

SI units and rad; unknown values are None. Each reader uses the sections that it shows.
"""

from __future__ import annotations

from math import degrees, isfinite
from typing import Any

import msgspec

from armadico.core.judgement import Answer
from armadico.core.membership import agent_of
from armadico.core.messages import plain
from armadico.core.services import service_at
from armadico.mobile.errand import Progress
from armadico.mobile.messages import unseen_m
from armadico.observe.diagnosis import diagnose
from armadico.observe.findings import Demand, short, summary
from armadico.observe.standing import standing
from armadico.observe.view import Seen, View, speed

Section = dict[str, Any]


def robot(view: View) -> Section | None:
    state, stop, level = view.state, view.stop, view.level
    if state is None:
        return None
    return {
        "v": state.v,
        "w": state.w,
        "speed": speed(state),
        "ordered": None if not state.driver else {"v": state.ordered.v, "w": state.ordered.w},
        "admitted": None if not state.driver else {"v": state.admitted.v, "w": state.admitted.w},
        "capped": state.capped,
        "driver": agent_of(state.driver) if state.driver else None,
        "battery_v": state.battery_v,
        "battery_share": None if level is None else level.share,
        "charging": state.charging,
        "battery": view.battery,
        "stalled": state.stalled,
        "motors": state.motors,
        "line": state.line.summary,
        "stopped_by": stop.by if stop.stopped else None,
        "cycle": state.cycle.number,
    }


def pose(view: View, now: float) -> Section | None:
    at = view.pose
    if at is None:
        return None
    known = bool(at.covariance)
    return {
        "x": at.x,
        "y": at.y,
        "theta": at.theta,
        "heading_deg": round(degrees(at.theta), 1),
        "deviation_m": at.deviation if known else None,
        "deviation_rad": at.heading_deviation if known else None,
        "confidence": view.confidence(now),
        "off_map": view.off_map(now),
        "lost_s": None if view.lost_since is None else round(now - view.lost_since, 1),
        "pose_text": view.pose_text(now),
    }


def slam(view: View, now: float) -> Section | None:
    """The map that is made meanwhile, in numbers."""
    graph = view.graph(now)
    if graph is None:
        return None
    return {
        "revision": graph.revision,
        "key_scans": graph.key_scans,
        "loops": graph.loops_found,
        "loops_off": graph.loops_off,
        "uncertain": graph.uncertain,
        "summary": graph.summary,
    }


def mission(view: View, now: float) -> Section | None:
    """The present or last goal; `silent_s` is the age of a status that is stale."""
    status = view.mission
    if status is None:
        return None
    return {
        "number": str(status.mission),
        "state": status.outcome,
        "to_go": status.to_go,
        "silent_s": view.mission_silent_s(now),
        "note": status.note,
        "due_s": status.due_s,
        "late": status.late,
        "owner": status.owner,
        "unseen_m": 0.0 if view.trajectory is None else unseen_m(view.trajectory.unseen),
    }


def errand(of: Progress) -> Section:
    """A mission of several tasks; its number is a string, because it exceeds JSON's numbers."""
    return {
        "number": str(of.number),
        "name": of.name,
        "state": of.state,
        "over": of.over,
        "priority": of.priority,
        "doing": of.summary,
        "ahead": list(of.ahead),
        "note": of.note,
        "done": of.done,
        "by": of.by,
    }


def diagnosis(view: View, now: float, demand: Demand) -> Section:
    """Why the robot stands, and all findings that are not fine.

    `beside` has in lines what is wrong beside the cause, and the summary, unless all is well.
    """
    findings, why = diagnose(view, demand, now), standing(view, now, demand)
    off = [each for each in findings if each.answer is not Answer.YES]
    found: Section = msgspec.to_builtins(why)
    shown = () if why.cause is None else ((why.cause.sort, why.cause.who),)
    found |= {"summary": summary(findings), "beside": short(findings, shown)}
    return found | {"findings": msgspec.to_builtins(off)}


def resource(view: View, name: str, now: float) -> Section:
    """A resource's holder, the agent that its owner obeys, and the contenders with their bids."""
    claim, obeyed = view.claim(name, now), view.driver(name, now)
    row: Section = {"resource": name, "holder": None}
    row["obeyed"] = None if obeyed is None else agent_of(obeyed)
    if claim is not None:
        row |= {
            "holder": claim.ballot.instance,
            "utility": claim.utility,
            "critical": claim.critical,
            "term": claim.ballot.term,
        }
    row["contenders"] = contenders = []
    for seen in view.agents:
        if seen.card is None or name not in seen.card.resources:
            continue
        bid = view.bid(seen.instance, name)
        each: Section = {"name": seen.name, "drives": seen.instance == obeyed}
        if seen.instance == row["holder"]:
            each |= {"utility": row["utility"], "critical": row["critical"], "reason": ""}
        elif bid is not None:
            each |= {"utility": bid.utility, "critical": bid.critical, "reason": bid.reason}
        contenders.append(each)
    return row


def agent(seen: Seen, *fields: str) -> Section:
    """A live agent, with all fields of its card, or some."""
    row: Section = {
        "name": seen.name,
        "instance": seen.instance,
        "answering": seen.card is not None,
    }
    if seen.card is not None:
        card = plain(seen.card)
        row |= {name: card[name] for name in fields or card}
    return row


def service(view: View, key: str, now: float) -> Section:
    rate, known = view.rates[key], service_at(key)
    hz = rate.hz(now)
    assert rate.last is not None, "something was received"
    return {
        "key": key,
        "hz": None if hz is None else round(hz, 2),
        "promised_hz": known.rate_hz if known else None,
        "missed": rate.missed,
        "age_s": round(now - rate.last, 2),
        "messages": rate.count,
    }


def rounded(value: object, digits: int = 3) -> Any:
    """The value with all numbers rounded, nested ones too; 0 for numbers that are not finite."""
    if isinstance(value, float):
        return round(value, digits) if isfinite(value) else 0.0
    if isinstance(value, dict):
        return {name: rounded(each, digits) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(each, digits) for each in value]
    return value
