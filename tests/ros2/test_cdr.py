"""Messages as bytes: what goes in comes out, and bytes of others raise ValueError soon."""

from __future__ import annotations

import json
import random
import subprocess
from dataclasses import asdict
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest
from pycdr2._support import Buffer

from armadico.bridge.ros2 import cdr, types
from tests import real_ros

TYPES = sorted(cdr.known().items())


@pytest.mark.parametrize(("name", "kind"), TYPES)
def test_a_new_message_comes_back(name, kind) -> None:
    assert cdr.decode(kind, cdr.encode(kind())) == kind()


def test_values_come_back() -> None:
    stamp = types.Time(sec=5, nanosec=7)
    header = types.Header(stamp=stamp, frame_id="läser")
    scan = types.LaserScan(header=header, angle_min=-1.5, ranges=[0.5, float("inf")])
    battery = types.BatteryState(present=True, cell_voltage=[1.5], serial_number="x")
    field = types.PointField(name="x", datatype=7, count=1)
    cloud = types.PointCloud2(fields=[field], data=b"\x01\x02", is_dense=True)
    pose = types.PoseStamped(header=header)
    for message in (scan, battery, types.Path(poses=[pose, pose]), types.String(data="")):
        assert cdr.decode(type(message), cdr.encode(message)) == message
    read = cdr.decode(types.PointCloud2, cdr.encode(cloud))
    assert (read.fields, bytes(read.data), read.is_dense) == ([field], b"\x01\x02", True)


def test_big_endian_is_read() -> None:
    data = b"\0\0\0\0" + (3).to_bytes(4, "big") + b"hi\0"
    assert cdr.decode(types.String, data).data == "hi"


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\0\1\0",
        b"\0\1\0\0",
        b"\0\1\0\0\xff\xff\xff\xffhi\0",  # four gigabytes of text
        b"\0\1\0\0\x02\0\0\0\xff\0",  # no UTF-8
        b"\0\x03\0\0\x03\0\0\0hi\0",  # a parameter list
        b"\1\1\0\0\x03\0\0\0hi\0",
    ],
)
def test_invalid_text_is_rejected(data) -> None:
    with pytest.raises(ValueError, match="std_msgs/msg/String"):
        cdr.decode(types.String, data)


def test_hostile_bytes_end_as_a_message_or_an_error() -> None:
    chance = random.Random(1)
    big = [b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\0", b"\0\0\1\0"]
    for _, kind in TYPES:
        whole = cdr.encode(kind())
        for _ in range(200):
            data = bytearray(whole[: chance.randrange(len(whole) + 1)])
            for _ in range(chance.randrange(5)):
                place = chance.randrange(len(data) + 1)
                data[place : place + 4] = chance.choice([*big, chance.randbytes(4)])
            try:
                read = cdr.decode(kind, bytes(data))
            except ValueError:
                continue
            assert isinstance(read, kind)


def test_what_does_not_fit_is_named() -> None:
    with pytest.raises(ValueError, match="sensor_msgs/msg/LaserScan cannot be encoded"):
        cdr.encode(types.LaserScan(ranges=["near"]))  # type: ignore[list-item]
    with pytest.raises(ValueError, match="geometry_msgs/msg/Twist "):
        cdr.encode(types.Twist(linear=None))  # type: ignore[arg-type]


def test_names() -> None:
    assert cdr.ros_name(types.LaserScan) == "sensor_msgs/msg/LaserScan"
    assert cdr.dds_name(types.LaserScan) == "sensor_msgs::msg::dds_::LaserScan_"
    assert cdr.from_dds_name("sensor_msgs::msg::dds_::LaserScan_") == "sensor_msgs/msg/LaserScan"
    assert cdr.from_dds_name("HelloWorldData::Msg") == "HelloWorldData::Msg"


# Real ROS 2's bytes ------------------------------------------------------------------------------

HERE = Path(__file__).parent
SAMPLES = json.loads((HERE / "samples.json").read_text())
GOLDEN = json.loads((HERE / "golden.json").read_text())


def fill(message: Any, values: dict[str, Any]) -> Any:
    """Set the fields that are given, as `rclpy_bytes` does."""
    for name, value in values.items():
        slot = getattr(message, name)
        if isinstance(value, dict):
            fill(slot, value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            hint = get_type_hints(type(message), include_extras=True)[name]
            element = get_args(hint)[1].subtype
            setattr(message, name, [fill(element(), each) for each in value])
        else:
            setattr(message, name, value)
    return message


def plain(value: Any) -> Any:
    """Lists for whatever is one: pycdr2 reads `uint8` as bytes."""
    if isinstance(value, dict):
        return {name: plain(each) for name, each in value.items()}
    return [plain(each) for each in value] if isinstance(value, (list, bytes)) else value


class Gaps(Buffer):
    """Records the bytes that are not written: Fast CDR leaves old memory there."""

    def __init__(self) -> None:
        super().__init__()
        self.skipped: set[int] = set()

    def align(self, alignment: int) -> Buffer:
        before = self._pos
        super().align(alignment)
        self.skipped |= {*range(before, self._pos)}
        return self


def unpadded(name: str, hexadecimal: str) -> list[int]:
    """The bytes of the sample that are written."""
    gaps = Gaps()
    fill(cdr.known()[name](), SAMPLES[name]).serialize(buffer=gaps)
    return [b for at, b in enumerate(bytes.fromhex(hexadecimal)) if at not in gaps.skipped]


@pytest.mark.parametrize("name", SAMPLES)
def test_bytes_and_hash_are_those_of_ros_2(name: str) -> None:
    kind, golden = cdr.known()[name], GOLDEN[name]
    message = fill(kind(), SAMPLES[name])
    ours = cdr.encode(message).hex()
    assert len(ours) == len(golden["bytes"])
    assert unpadded(name, ours) == unpadded(name, golden["bytes"])
    assert plain(asdict(cdr.decode(kind, bytes.fromhex(golden["bytes"])))) == plain(asdict(message))
    assert cdr.type_hash(kind) == golden["hash"]


def test_the_golden_bytes_are_those_of_rclpy() -> None:
    done = subprocess.run(
        [real_ros.interpreter(), HERE / "rclpy_bytes.py"],
        env=real_ros.environment(str(real_ros.NOBODYS)),
        stdout=subprocess.PIPE,
        check=True,
    )
    today = json.loads(done.stdout)
    assert len(today) >= 10
    for name, now in today.items():
        assert unpadded(name, now["bytes"]) == unpadded(name, GOLDEN[name]["bytes"])
        assert now["hash"] == GOLDEN[name]["hash"]


def test_the_type_of_discovery_has_the_hash_of_rmw() -> None:
    # As read from a node's endpoint on `ros_discovery_info`.
    expected = "RIHS01_91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e"
    assert cdr.type_hash(types.ParticipantEntitiesInfo) == expected
