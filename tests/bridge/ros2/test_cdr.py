"""Messages as bytes: what goes in comes out, and bytes of others raise ValueError soon."""

from __future__ import annotations

import random

import pytest

from armadico.bridge.ros2 import cdr, types

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
def test_what_is_no_text_is_said(data) -> None:
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


def test_a_definition_has_its_nested_types() -> None:
    text = cdr.definition(types.Path)
    assert text.startswith("std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses\n")
    assert f"{'=' * 80}\nMSG: geometry_msgs/PoseStamped\n" in text
    assert "float64[36] covariance" in cdr.definition(types.PoseWithCovariance)
