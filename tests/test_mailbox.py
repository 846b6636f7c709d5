"""The mailbox's promises: states keep the latest, events are bounded and counted, order is kept."""

from __future__ import annotations

from collections.abc import Callable

from hypothesis import given
from hypothesis import strategies as st

from armadico.mailbox import Mailbox

LIMIT = 4


def item(value: int) -> Callable[[], int]:
    return lambda: value


def drain(mailbox: Mailbox) -> list[int]:
    taken = []
    while (found := mailbox.take()) is not None:
        taken.append(found())
    return taken


def test_a_state_takes_the_place_of_the_one_before_and_its_turn_is_the_newer_ones() -> None:
    mailbox = Mailbox()
    mailbox.put_state("pose", item(1))
    mailbox.put_event(item(2))
    mailbox.put_state("pose", item(3))
    assert drain(mailbox) == [2, 3]


def test_states_of_different_keys_do_not_replace_each_other() -> None:
    mailbox = Mailbox()
    mailbox.put_state("pose", item(1))
    mailbox.put_state("sonar", item(2))
    assert drain(mailbox) == [1, 2]


def test_events_are_all_kept_in_order() -> None:
    mailbox = Mailbox()
    for value in range(10):
        mailbox.put_event(item(value))
    assert drain(mailbox) == list(range(10))


def test_beyond_the_limit_the_oldest_event_goes_and_is_counted() -> None:
    mailbox = Mailbox(LIMIT)
    for value in range(LIMIT + 3):
        mailbox.put_event(item(value))
    assert mailbox.dropped == 3
    assert drain(mailbox) == [3, 4, 5, 6]


class Model:
    """What a mailbox should do, said plainly: one list in order of arrival."""

    def __init__(self) -> None:
        self.waiting: list[tuple[str | None, int]] = []
        self.dropped = 0

    def put(self, key: str | None, value: int) -> None:
        if key is not None:
            self.waiting = [entry for entry in self.waiting if entry[0] != key]
        elif sum(entry[0] is None for entry in self.waiting) == LIMIT:
            self.waiting.remove(next(entry for entry in self.waiting if entry[0] is None))
            self.dropped += 1
        self.waiting.append((key, value))

    def take(self) -> int | None:
        return self.waiting.pop(0)[1] if self.waiting else None


@given(st.lists(st.sampled_from(["a", "b", "event", "event", "take"]), max_size=60))
def test_it_does_what_the_model_does(steps: list[str]) -> None:
    mailbox, model = Mailbox(LIMIT), Model()
    for value, step in enumerate(steps):
        if step == "take":
            found = mailbox.take()
            assert (None if found is None else found()) == model.take()
        elif step == "event":
            mailbox.put_event(item(value))
            model.put(None, value)
        else:
            mailbox.put_state(step, item(value))
            model.put(step, value)
        assert len(mailbox) == len(model.waiting)
    assert drain(mailbox) == [value for _, value in model.waiting]
    assert mailbox.dropped == model.dropped
