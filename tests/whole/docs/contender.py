"""A contender for the wheels by rules 1 to 8 of docs/protocol.md, with nothing of Armadico's.

It reads the lines of a transcript that are meant for it, and writes what it publishes:
`python -m armadico_tools.transcripts inputs FILE --agent b | python contender.py FILE b`.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cbor2

PERIOD, SILENCE, UNOBEYED, MARGIN, JUMP = 0.1, 2.3, 6, 0.05, 2**32
Line = dict[str, Any]


class Contender:
    """One process: messages and the time in, lines out."""

    def __init__(self, instance: str, steps: list[Line]) -> None:
        self.instance = instance
        self.steps = steps
        self.said: list[Line] = []
        self.state = "idle"
        # Cycles
        self.newest: list[int] | None = None
        self.received_at = -1e9
        self.listens_until = self.resumed = 0
        # Who drives
        self.largest: list[Any] | None = None
        self.ballot: list[Any] | None = None
        self.began = 0
        self.ack: list[Any] | None = None
        self.rival: Line | None = None
        self.bids: dict[int, Line] = {}
        self.heard_at = self.looked_at = -1e9
        self.take_at: float | None = None
        self.turned: list[int] | None = None
        # The stop
        self.counter, self.stopped = 0, False
        self.presses: list[int] = []

    # Cycles --------------------------------------------------------------------------------------

    def alive(self, now: float) -> bool:
        return now - self.received_at <= 3 * PERIOD

    def advance(self, cycle: list[int], now: float) -> None:
        if self.newest is None or (cycle[0] != self.newest[0] and not self.alive(now)):
            self.listens_until, self.resumed = cycle[1] + 3, cycle[1]
        elif cycle[0] != self.newest[0] or cycle[1] <= self.newest[1]:
            return
        elif missed := cycle[1] - self.newest[1] - 1:
            if missed > 3 + 2 * (now - self.received_at) / PERIOD and self.alive(now):
                return
            self.listens_until, self.resumed = cycle[1] + min(missed, 3), cycle[1]
        self.newest, self.received_at = cycle, now

    def fresh(self, cycle: list[int], within: int = 3) -> bool:
        new = self.newest
        return new is not None and cycle[0] == new[0] and -3 <= new[1] - cycle[1] <= within

    @property
    def listening(self) -> bool:
        return self.newest is None or self.newest[1] < self.listens_until

    # What comes in -------------------------------------------------------------------------------

    def take(self, line: Line) -> None:
        what, now = line["what"], line["t"]
        if what == "disappears":
            self.gone(line["key"].split("/")[2], now)
        if what != "publishes":
            return
        fields = cbor2.loads(bytes.fromhex(line["cbor"]))
        if line["type"] == "RobotState":
            self.advance(fields[0], now)
            self.stop(*fields[9])
        elif line["type"] == "Stop":
            self.stop(*fields)
        elif line["type"] == "Claim":
            self.claim(fields, now)
        elif line["type"] == "Ack":
            self.acked(fields, now)

    def stop(self, counter: int, stopped: bool, by: str, press: int) -> None:
        seen = press in self.presses
        if stopped and not seen:
            self.presses.append(press)
        if stopped and (counter > self.counter or not seen):
            self.counter, self.stopped = max(counter, self.counter + (not self.stopped)), True
        elif not stopped and counter > self.counter:
            self.counter, self.stopped = counter, False

    def claim(self, fields: list[Any], now: float) -> None:
        _, ballot, cycle, utility, critical, *_ = fields
        if ballot[3] == self.instance or not self.fresh(cycle) or not self.plausible(ballot):
            return
        if self.largest is not None and ballot < self.largest:
            return
        self.largest = ballot
        self.outbid(now)
        self.follow(ballot, cycle, utility, critical)
        assert self.rival is not None
        self.rival["cycle"], self.rival["gone"], self.heard_at = cycle, utility is None, now
        self.consider(now)

    def follow(self, ballot: list[Any], cycle: list[int], utility: Any, critical: bool) -> None:
        if self.rival is None or self.rival["ballot"] != ballot:
            assert self.newest is not None
            self.rival = {"ballot": ballot, "since": self.newest, "cycle": cycle}
            self.rival |= {"claims": {}, "gone": False}
        if utility is not None:
            self.rival["claims"].setdefault(tuple(cycle), (utility, critical))

    def acked(self, ack: list[Any], now: float) -> None:
        _, cycle, largest, obeyed, at, utility, critical, _ = ack
        if not self.fresh(cycle):
            return
        self.ack = ack
        rival = self.rival
        if largest is not None and self.plausible(largest):
            if self.largest is None or largest > self.largest:
                self.largest = largest
                if rival is not None and largest > rival["ballot"]:
                    self.rival, self.heard_at = None, now
            if self.ballot is not None and largest > self.ballot:
                self.outbid(now)
            elif rival is not None and rival["ballot"] == largest and obeyed is None:
                rival["gone"] = rival["gone"] or (at is not None and at >= rival["cycle"])
            others = obeyed is not None and obeyed[3] != self.instance
            if others and obeyed == self.largest and self.fresh(at):
                self.follow(obeyed, at, utility, critical)
        if next(reversed(self.bids), cycle[1]) >= cycle[1]:  # else this cycle's bid is to come
            self.consider(now)
        if self.turned is None or self.turned[0] != cycle[0] or self.turned[1] < cycle[1]:
            self.turned = cycle
            self.turn(cycle, now)

    def gone(self, instance: str, now: float) -> None:
        if self.rival is None or self.rival["ballot"][3] != instance:
            return
        if now < self.silent_at and not self.listening:
            self.rival["gone"] = True
        self.consider(now)

    def plausible(self, ballot: list[Any]) -> bool:
        return bool(ballot[0] <= (self.largest[0] if self.largest else 0) + JUMP)

    # What it does --------------------------------------------------------------------------------

    def turn(self, cycle: list[int], now: float) -> None:
        steps = [s for s in self.steps if s["from_cycle"] <= cycle[1]]
        bid = steps[-1] if steps else None
        if self.stopped or not self.alive(now) or bid is None or bid["utility"] is None:
            self.bids.clear()
            self.state = "contending" if self.ballot else "idle"
            self.release()
            self.state = "idle"
            return
        self.bids[cycle[1]] = bid
        while len(self.bids) > 4:
            del self.bids[next(iter(self.bids))]
        if self.ballot is None:
            self.state = "contending"
            self.consider(now)
        elif len(self.bids) == 4 and not any(b["utility"] for b in self.bids.values()):
            self.release()
            self.state = "idle"
        else:
            self.speak(cycle, bid)

    def outbid(self, now: float) -> None:
        if self.ballot is not None:
            self.ballot, self.heard_at, self.state = None, now, "contending"

    def release(self) -> None:
        if self.ballot is None:
            return
        ballot, self.ballot, self.heard_at = self.ballot, None, -1e9
        self.bids.clear()
        self.say(f"robot/cmd/{self.instance}", ["wheels", self.newest, ballot, None])
        nothing = ["wheels", ballot, self.newest, None, False, [], [0.0, 0.0]]
        self.say(f"resource/wheels/utility/{self.instance}", nothing)

    def speak(self, cycle: list[int], bid: Line) -> None:
        action = bid["action"]
        self.say(f"robot/cmd/{self.instance}", ["wheels", cycle, self.ballot, action])
        rank = [bid["utility"], bid.get("critical", False)]
        claim = ["wheels", self.ballot, cycle, *rank, action, action]
        self.say(f"resource/wheels/utility/{self.instance}", claim)

    @property
    def silent_at(self) -> float:
        return self.heard_at + SILENCE * PERIOD

    def consider(self, now: float) -> None:
        if self.state != "contending" or self.ballot is not None or not self.bids:
            return
        number = next(reversed(self.bids))
        bid = self.bids[number]
        better, reason = self.reason(number, bid, now)
        if not reason:
            self.take_at = None
            return
        if not better:
            if self.take_at is None:  # the longest draw: it comes before nobody in the file
                self.take_at = now + 0.1 * PERIOD * (0.5 * (1 - bid["utility"]) + 0.5)
            if now < self.take_at:
                return
        self.take_at, self.rival, self.heard_at = None, None, now
        term = (self.largest[0] if self.largest else 0) + 1
        self.ballot = [term, bid["utility"], bid.get("critical", False), self.instance]
        self.largest, self.state = self.ballot, "holding"
        assert self.newest is not None
        self.began = number
        self.now = now
        self.speak([self.newest[0], number], bid)

    def reason(self, number: int, bid: Line, now: float) -> tuple[bool, bool]:
        new, ack, rival = self.newest, self.ack, self.rival
        if new is None or not bid["utility"] or self.listening or not self.alive(now):
            return False, False
        if ack is None or not self.fresh(ack[1]) or not self.fresh([new[0], number]):
            return False, False
        if rival is not None and rival["gone"]:
            return False, True
        obeyed, at = ack[3], ack[4]
        lately = at is not None and self.fresh(at, 1) and obeyed is not None
        claimed = rival is not None and [new[0], number] <= rival["cycle"]
        obeyed_still = lately and obeyed >= (self.largest or [])
        if now >= self.silent_at and not obeyed_still and not claimed:
            return False, True
        if rival is None:
            return False, False
        since = rival["since"][1] if rival["since"][0] == new[0] else 0
        last = max(self.resumed, since)
        if obeyed is not None and at[0] == new[0]:
            last = max(last, at[1])
        if new[1] - last > UNOBEYED:
            return False, True
        for mine in reversed(self.bids):
            theirs = rival["claims"].get((new[0], mine))
            if theirs is not None:
                utility, critical = self.bids[mine]["utility"], self.bids[mine].get("critical")
                better = utility > theirs[0] + MARGIN
                equal = bool(critical) and not theirs[1] and utility >= theirs[0]
                return better or equal, better or equal
        return False, False

    # Time ----------------------------------------------------------------------------------------

    now = 0.0

    def wake(self, until: float) -> None:
        while self.state == "contending" and self.ballot is None:
            due = self.take_at
            if due is None and self.rival is not None and self.silent_at > self.looked_at:
                due = self.silent_at
            if due is None or due >= until:
                return
            self.now = self.looked_at = max(due, self.now)
            self.consider(self.now)

    def say(self, key: str, fields: list[Any]) -> None:
        self.said.append({"t": self.now, "key": key, "cbor": cbor2.dumps(fields).hex()})


def run(instance: str, steps: list[Line], lines: Iterable[Line], ends: float) -> list[Line]:
    """Live through the lines of a transcript."""
    me = Contender(instance, steps)
    asleep = -1.0
    for line in lines:
        if line["what"] in {"is killed", "leaves"}:
            if line["what"] == "leaves":
                me.now = line["t"]
                me.release()
            return me.said
        if line["what"] == "hangs":
            asleep = float("inf")
        elif line["what"] == "returns":
            asleep = line["t"] + 0.001  # what waited is read before anything is done
        if line["t"] >= asleep:
            me.wake(line["t"])
        me.now = max(me.now, line["t"])
        me.take(line)
    me.wake(ends)
    return me.said


if __name__ == "__main__":
    with Path(sys.argv[1]).open(encoding="utf-8") as file:
        head, label = json.loads(next(file)), sys.argv[2]
    part = next(p for p in head["agents"] if p["name"] == label)
    given = [json.loads(text) for text in sys.stdin]
    for said in run(part["instance"], part["bids"]["wheels"], given, head["ends"]):
        sys.stdout.write(json.dumps(said) + "\n")
