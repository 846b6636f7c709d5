"""Of any two processes one connects: who that is, and that Zenoh's gossip sees it the same way."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import ExitStack

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from armadico.mesh.ports import private_endpoints
from armadico.mesh.topology import LAST_RANK, one_way
from armadico.mesh.zenoh import SETTINGS, _session_id

KNOWN = tuple(f"tcp/10.0.0.{host}:{port}" for host in (1, 2, 3) for port in (7447, 7448))


@given(st.lists(st.sampled_from(KNOWN), min_size=2, max_size=2, unique=True))
def test_of_two_well_known_endpoints_the_later_connects_to_the_earlier(pair: list[str]) -> None:
    one, other = pair
    to_other = other in one_way((one,), KNOWN)[0]
    to_one = one in one_way((other,), KNOWN)[0]
    assert to_other is not to_one
    later, earlier = sorted(pair, key=KNOWN.index, reverse=True)
    assert earlier in one_way((later,), KNOWN)[0]
    assert one_way((later,), KNOWN)[1] > one_way((earlier,), KNOWN)[1]


def test_who_has_no_well_known_endpoint_connects_to_all() -> None:
    assert one_way(("tcp/10.0.0.1:0",), KNOWN) == (KNOWN, LAST_RANK)
    assert one_way((), KNOWN) == (KNOWN, LAST_RANK)


def test_ranks_fit_into_a_byte_however_many_endpoints_there_are() -> None:
    many = tuple(f"tcp/10.0.0.1:{port}" for port in range(7000, 7400))
    assert one_way((many[-1],), many) == (many[:-1], LAST_RANK - 1)


@given(st.integers(1, LAST_RANK))
def test_a_session_id_is_one_that_zenoh_takes(rank: int) -> None:
    config = zenoh.Config()
    config.insert_json5("id", json.dumps(_session_id(rank)))


@pytest.fixture
def sessions() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def session(stack: ExitStack, rank: int, connect: list[str]) -> tuple[zenoh.Session, str]:
    """A peer on a port of its own, which knows others by gossip only; and its endpoint."""
    endpoint = private_endpoints(1)
    config = zenoh.Config()
    own = {"id": _session_id(rank), "listen/endpoints": [endpoint], "connect/endpoints": connect}
    for key, value in (SETTINGS | own).items():
        config.insert_json5(key, json.dumps(value))
    return stack.enter_context(zenoh.open(config)), endpoint


@pytest.mark.parametrize("ranks", [(1, LAST_RANK), (LAST_RANK, 1)])
def test_by_gossip_too_the_larger_rank_connects(
    sessions: ExitStack, ranks: tuple[int, int]
) -> None:
    _, seed = session(sessions, 100, [])
    met = zenoh.handlers.FifoChannel(16)
    first, first_at = session(sessions, ranks[0], [seed])
    listener = first.info.declare_link_events_listener(met, history=False)
    _, second_at = session(sessions, ranks[1], [seed])
    links = (listener.recv().link for _ in range(2))
    both = [{str(link.src), str(link.dst)} for link in links]
    (ends,) = [ends for ends in both if seed not in ends]
    listens = first_at if ranks[0] < ranks[1] else second_at
    assert listens in ends, "the smaller rank is connected to, where it listens"
