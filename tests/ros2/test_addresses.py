"""Addresses of ROS 2 robots."""

from __future__ import annotations

import pytest

from armadico.bridge.lines import TransportError
from armadico.bridge.ros2.addresses import client_transport, read_address
from armadico.bridge.ros2.samples import Address
from tests.real_ros import NOBODYS


@pytest.fixture(autouse=True)
def no_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)


@pytest.mark.parametrize(
    ("url", "address"),
    [
        ("ros2://", Address("", 0)),
        ("ros2://Tb_1/base?domain=0&interface=wlan0", Address("Tb_1/base", 0, "wlan0")),
        ("ros2+zenoh:///tb1", Address("tb1", 0, endpoint="tcp/localhost:7447")),
        (
            "ros2+zenoh://10.0.0.7:1234/a/b?domain=3",
            Address("a/b", 3, endpoint="tcp/10.0.0.7:1234"),
        ),
        ("ros2+zenoh://[::1]/", Address("", 0, endpoint="tcp/[::1]:7447")),
    ],
)
def test_addresses(url: str, address: Address) -> None:
    assert read_address(url) == address


def test_the_domain_is_the_environments_where_none_is_given(monkeypatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "30")
    assert read_address("ros2://").domain == 30
    assert read_address("ros2://?domain=1").domain == 1


@pytest.mark.parametrize(
    ("url", "wrong"),
    [
        ("ros2://a b", "'a b' is no namespace"),
        ("ros2://?domain=233", "from 0 to 232"),
        ("ros2://?domian=1", "'domian' is none of domain, interface"),
        ("ros2://?interface=", "no network interface"),
        ("ros2+zenoh://h:99999/", "ort"),
        ("ros2+zenoh://h?interface=lo", "'interface' is none of domain"),
        ("ros3://", "begins with none of"),
    ],
)
def test_bad_addresses_are_rejected_with_the_reason(url: str, wrong: str) -> None:
    with pytest.raises(ValueError, match=wrong):
        read_address(url)


def test_an_interface_that_is_not_there() -> None:
    pytest.importorskip("cyclonedds")
    with pytest.raises(TransportError, match=f"cannot join DDS domain {NOBODYS}"):
        client_transport(f"ros2://?domain={NOBODYS}&interface=none7").open()
