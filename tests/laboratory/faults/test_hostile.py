"""A program that queries the assistant agent 1,000 times a second, under faults."""

from __future__ import annotations

import json
from collections import Counter
from random import Random

import pytest

from armadico.core.messages import Claim, Command, Message, Stop, decode, next_count
from armadico.core.services import RELEASE, service_of
from armadico.launch.virtual_session import VirtualSession
from armadico.watch.assistant.assistant import Assistant
from armadico.watch.assistant.messages import AssistantRecord, AssistantReply, AssistantRequest
from armadico.watch.assistant.tools import TOOLS
from armadico_tools.faults.variants import case_of
from armadico_tools.faults.workload import Workload

EVERY_S = 0.001
RELEASED_S = 1.0
"""A person releases its stops, so that there is something to break."""

SECONDS = 12.0


class Hostile:
    """The program: whatever comes to its mind, sense and nonsense."""

    def __init__(self, workload: Workload, seed: int) -> None:
        self.mesh = workload.mesh
        self.rng = Random(f"hostile/{seed}")
        self.requested: Counter[str] = Counter()
        self.replies: Counter[str] = Counter()  # done, refused, or nothing at all
        self.records: list[AssistantRecord] = []
        self.contended = 0  # claims and commands of the assistant agent
        self.stops: list[Stop] = []
        workload.rehearsal.add(Assistant)
        self.agent = self.mesh.node("assistant").agent
        self.place = VirtualSession(self.mesh, name="hostile")
        self.mesh.watch(lambda _key, record, _now: self.records.append(record), AssistantRecord)
        self.mesh.watch(self._contends, Claim, Command)
        self.mesh.watch(lambda _key, stop, _now: self.stops.append(stop), Stop)
        self.mesh.call_at(1.0, self._query)
        self.mesh.call_at(1.0, self._release)

    def _contends(self, _key: str, message: Message, _now: float) -> None:
        assert isinstance(message, Claim | Command)
        self.contended += message.ballot.instance.startswith("assistant")

    def _query(self, *_: object) -> None:
        self.mesh.call_at(self.mesh.now + EVERY_S, self._query)
        rng = self.rng
        tool = rng.choice([*TOOLS, "drive", "cmd/robot", "goto", "goto"])
        if tool == "stop" and rng.random() < 0.997:  # or it would stand all the time
            tool = "resume"
        arguments = {
            "goto": {
                "x": rng.choice([rng.uniform(-2, 12), 1e6, -1e300, "0", None]),
                "y": rng.choice([rng.uniform(-5, 5), 1e-300, [], {}]),
                "heading": rng.choice([0, 360, -1e9]),
            },
            "mission": {"name": rng.choice(["surveillance", "../../etc/passwd", "", "rounds"])},
            "cancel": {"number": str(rng.getrandbits(rng.choice([1, 63, 64])))},
            "why": {"what": rng.choice(["now", "standing", "never"])},
        }.get(tool, {})
        text = rng.choice(
            [json.dumps(arguments), json.dumps(arguments), "{}", "[" * 1000, "nul", "\U0010ffff"]
        )
        self.requested[tool] += 1
        request = AssistantRequest(tool, text, rng.choice(["model", "goto", "ann", ""]))
        replies: list[bytes] = []
        key = service_of(AssistantRequest).key
        self.place.query(
            key, request, 5.0, lambda _k, data: replies.append(data), lambda: self._end(replies)
        )

    def _end(self, replies: list[bytes]) -> None:
        if not replies:
            self.replies["nothing"] += 1
            return
        reply = decode(replies[0], AssistantReply)
        self.replies["refused" if reply.refusal else "done"] += 1

    def _release(self, *_: object) -> None:
        """A person looks after it, and releases what it has stopped."""
        self.mesh.call_at(self.mesh.now + RELEASED_S, self._release)
        stop = self.agent.stopped
        if stop is not None and stop.by.startswith("assistant"):
            release = Stop(next_count(stop.counter), False, "a person", stop.press)
            self.place.publish(RELEASE.key_for(instance="guest-p"), release)


@pytest.mark.long(but=("702",))
@pytest.mark.parametrize("seed", [702])
def test_a_program_that_queries_everything_breaks_no_promise(seed: int) -> None:
    workload = Workload(case_of(seed, SECONDS, variant="sonar"))
    hostile = Hostile(workload, seed)
    outcome = workload.run()
    assert not outcome.violations
    assert outcome.driven_m > 1.0, "there was something to break"
    assert hostile.requested.total() > 900 * SECONDS
    assert hostile.contended == 0
    released = {stop.by for stop in hostile.stops if not stop.stopped}
    assert not [by for by in released if by.startswith("assistant")]
    # All that was taken is on the mesh with its text; what was too much is counted there.
    texts = {record.request.text for record in hostile.records}
    assert len(texts) >= 5
    assert sum(record.left_out for record in hostile.records) > 0.9 * hostile.replies["refused"]
    assert len(hostile.records) < 2 * (20 + 2 * SECONDS)
