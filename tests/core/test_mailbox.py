"""The mailbox's promises: states keep the latest, events are bounded and counted, order is kept."""

from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from armadico.core import mailbox as box
from armadico.core.mailbox import EVENTS, LANES, URGENT, Mailbox

LIMIT = 4


def drain(mailbox: Mailbox[int]) -> list[int]:
    taken = []
    while (found := mailbox.get()) is not None:
        taken.append(found)
    return taken


def test_beyond_the_limit_the_oldest_event_of_its_key_goes_and_is_counted() -> None:
    mailbox: Mailbox[int] = Mailbox()
    mailbox.put("log/b", 100)
    for value in range(EVENTS + 3):
        mailbox.put("log/a", value)
    assert mailbox.dropped == {"log/a": 3}
    assert drain(mailbox) == [100, *range(3, EVENTS + 3)]


def test_a_stop_overtakes_all_that_waits() -> None:
    mailbox: Mailbox[int] = Mailbox()
    for value in range(3):
        mailbox.put(f"log/{value}", value)
    mailbox.put(URGENT, 9, keep=1)
    assert drain(mailbox) == [9, 0, 1, 2]


def test_no_flood_on_other_keys_pushes_out_a_stop_a_token_a_reply_or_the_devices_bytes() -> None:
    mailbox: Mailbox[int] = Mailbox()
    lanes = ("robot/stop", "token/goto-1", "reply/goto-1/3", "device", "query/path/plan")
    for value, lane in enumerate(lanes):
        mailbox.put(lane, value)
    for value in range(100, 100 + 10 * EVENTS):
        mailbox.put("resource/wheels/utility", value)
        mailbox.put(f"robot/cmd/{value % 7}", value)
    taken = drain(mailbox)
    assert taken[: len(lanes)] == list(range(len(lanes)))
    assert set(mailbox.dropped) == {
        "resource/wheels/utility",
        *(f"robot/cmd/{n}" for n in range(7)),
    }


def test_keys_are_bounded_too_and_what_they_cost_is_counted() -> None:
    mailbox: Mailbox[int] = Mailbox()
    for value in range(LANES + 5):
        mailbox.put(f"robot/cmd/{value}", value)
    assert len(mailbox) == LANES
    assert mailbox.dropped == {"robot/cmd/*": 5}
    assert len(drain(mailbox)) == LANES


def test_keys_that_are_too_many_take_no_others_place() -> None:
    mailbox: Mailbox[int] = Mailbox()
    for value in range(5 * LANES):
        mailbox.put(f"robot/cmd/{value}", value)
    lanes = ("robot/stop", "robot/state", "token/goto-1", "reply/goto-1/3", "device")
    for value, lane in enumerate(lanes):
        mailbox.put(lane, -1 - value)
    assert drain(mailbox)[-len(lanes) :] == [-1 - value for value in range(len(lanes))]
    mailbox.put("robot/cmd/again", 7)
    assert drain(mailbox) == [7], "those that were taken are not counted"


class Model:
    """A simple model of a mailbox: one list in order of arrival."""

    def __init__(self) -> None:
        self.waiting: list[tuple[str, int]] = []
        self.dropped: Counter[str] = Counter()

    def put(self, key: str, value: int, keep: int) -> None:
        own = [place for place, (other, _) in enumerate(self.waiting) if other == key]
        if keep == 1 and own:
            self.waiting[own[0]] = (key, value)
            return
        if len(own) == keep:
            del self.waiting[own[0]]
            self.dropped[key] += 1
        self.waiting.append((key, value))

    def take(self) -> int | None:
        return self.waiting.pop(0)[1] if self.waiting else None


@given(st.lists(st.sampled_from(["a", "b", "event", "event", "other", "take"]), max_size=60))
def test_it_does_what_the_model_does(steps: list[str]) -> None:
    mailbox, model = Mailbox[int](), Model()
    for value, step in enumerate(steps):
        if step == "take":
            assert mailbox.get() == model.take()
        else:
            keep = 1 if step in "ab" else LIMIT
            mailbox.put(step, value, keep)
            model.put(step, value, keep)
        assert len(mailbox) == len(model.waiting)
    assert drain(mailbox) == [value for _, value in model.waiting]
    assert mailbox.dropped == model.dropped


def test_what_is_counted_is_bounded_by_the_keys() -> None:
    mailbox: Mailbox[int] = Mailbox()
    for value in range(2 * box.LANES):
        for _ in range(3):
            mailbox.put(f"log/{value}", value, keep=2)
        drain(mailbox)
    assert len(mailbox.dropped) <= LANES
