"""The gateway declares what it subscribes to, so that keys give it the rights to do so."""

from __future__ import annotations

from armadico.bridge.ros2.gateway.society import Society
from armadico.bridge.ros2.guest import Gateway


def test_the_gateway_declares_all_that_it_translates() -> None:
    assert {*Society().kinds} <= {*Gateway.receives}
