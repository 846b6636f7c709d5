"""The table of services: each message has one key, one kind and one freshness."""

from __future__ import annotations

import pytest

from armadico.core import messages as m
from armadico.core import services
from armadico.core.services import (
    BIDS,
    CARD,
    Kind,
    Service,
    derived,
    register,
    service_at,
    service_of,
    state,
)
from armadico.mobile.messages import Pose
from armadico.mobile.resources import TRAJECTORY


class Whistle(m.Message, frozen=True):
    cycle: m.Cycle
    pitch: float


WHISTLE = Service(Whistle, "whistle/{instance}", Kind.EVENT, None, 8, "a test's own")


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch) -> None:
    """A table of one's own to add to."""
    monkeypatch.setattr(services, "_by_message", dict(services._by_message))
    monkeypatch.setattr(services, "_rows", list(services._rows))


def test_keys_are_filled_with_names_and_patterns_catch_them_all() -> None:
    command, claim = service_of(m.Command), service_of(m.Claim)
    assert command.key_for(instance="goto-1") == "robot/cmd/goto-1"
    assert command.pattern == "robot/cmd/*"
    assert claim.key_for(resource="wheels", instance="goto-1") == "resource/wheels/utility/goto-1"
    assert claim.pattern == "resource/*/utility/*"
    assert CARD.key_for(name="goto", instance="goto-1") == "agent/goto/goto-1/card"
    assert BIDS.pattern == "agent/*/*/bids"
    with pytest.raises(KeyError):
        command.key_for(name="goto")


@pytest.mark.usefixtures("registry")
def test_an_agent_may_bring_a_message_of_its_own() -> None:
    with pytest.raises(KeyError, match=r"services\.register adds one"):
        service_of(Whistle)
    assert register(WHISTLE) is WHISTLE
    assert service_of(Whistle) is WHISTLE
    register(WHISTLE)


@pytest.mark.usefixtures("registry")
def test_a_key_cannot_be_given_a_second_message() -> None:
    with pytest.raises(ValueError, match="Whistle: encoder/pose already carries Pose"):
        register(Service(Whistle, "encoder/pose", Kind.STATE, 10, 3, "another"))


@pytest.mark.usefixtures("registry")
def test_a_message_cannot_be_given_a_second_key() -> None:
    with pytest.raises(ValueError, match="Pose already travels on encoder/pose"):
        register(Service(Pose, "my/pose", Kind.STATE, 10, 3, "another"))


def test_a_resource_is_spoken_of_at_its_own_rate() -> None:
    assert promised("resource/wheels/ack") == 10
    assert promised("resource/trajectory/ack") == 1 / (TRAJECTORY.period_s or 0.1)
    assert promised("resource/nobody-knows-it/ack") is None


def promised(key: str) -> float | None:
    service = service_at(key)
    assert service is not None
    return service.rate_hz


class Signals(m.Message, frozen=True):
    """A base."""


def test_a_base_stands_for_what_is_installed_of_it_and_a_message_for_itself(
    registry: None,
) -> None:
    assert derived(Signals) == ()

    class Flag(Signals, frozen=True):
        cycle: m.Cycle

    assert derived(Signals) == ()  # it has no row
    state(Flag, "flag", 10, 3, "a test's own")
    assert derived(Signals) == (Flag,)
    assert derived(Pose) == (Pose,)
