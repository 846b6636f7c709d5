"""Where sensors sit by tf_static: chains of frames, whatever hangs on what."""

from __future__ import annotations

from math import cos, nan, pi, radians, sin

import pytest

from armadico.bridge.ros2.mounts import MOST, Frames, Mount
from armadico.bridge.ros2.types import (
    Header,
    Quaternion,
    TFMessage,
    Transform,
    TransformStamped,
    Vector3,
)

LEFT = Quaternion(z=sin(pi / 4), w=cos(pi / 4))
HANGING = Quaternion(x=1.0, w=0.0)


def fixed(
    parent: str,
    child: str,
    x: float = 0.0,
    y: float = 0.0,
    z: float = 0.0,
    turned: Quaternion | None = None,
) -> TransformStamped:
    transform = Transform(Vector3(x, y, z), turned or Quaternion())
    return TransformStamped(Header(frame_id=parent), child, transform)


def frames(*transforms: TransformStamped) -> Frames:
    """One message each, as several publishers send them."""
    made = Frames()
    for each in transforms:
        made.on_tf_static(TFMessage([each]))
    return made


BURGER = (
    fixed("base_footprint", "base_link", z=0.01),
    fixed("base_link", "base_scan", -0.032, z=0.172),
    fixed("base_link", "imu_link", -0.032, z=0.068),
)


def test_a_sensor_hangs_on_the_base_by_other_frames() -> None:
    found = frames(*BURGER).mount("base_footprint", "base_scan")
    assert found is not None
    assert found.place == pytest.approx((-0.032, 0.0, 0.0))
    assert (found.upside_down, found.tilt) == (False, pytest.approx(0.0))


def test_the_base_may_be_any_frame_of_the_tree() -> None:
    turned = (
        fixed("root", "base_link", 1.0, 2.0, turned=LEFT),
        fixed("root", "shell", 1.0, 3.0),
        fixed("shell", "laser", 0.5, turned=LEFT),
    )
    found = frames(*reversed(turned)).mount("base_link", "/laser")
    assert found is not None
    assert found.place == pytest.approx((1.0, -0.5, 0.0))


def test_one_that_hangs_looks_where_it_looks() -> None:
    found = frames(fixed("plate", "laser", turned=HANGING), fixed("base", "plate", turned=LEFT))
    mount = found.mount("base", "laser")
    assert mount is not None
    assert mount.upside_down
    assert mount.place == pytest.approx((0.0, 0.0, pi / 2))
    assert mount.tilt == pytest.approx(0.0)


def test_one_that_is_tilted_is_so_by_as_much() -> None:
    down = Quaternion(y=sin(radians(10.0)), w=cos(radians(10.0)))
    mount = frames(fixed("base", "laser", turned=down)).mount("base", "laser")
    assert mount is not None
    assert mount.tilt == pytest.approx(radians(20.0))


def test_an_unpublished_frame_is_unknown() -> None:
    assert frames(*BURGER).mount("base_link", "laser") is None
    assert frames(*BURGER).mount("other/base_link", "base_scan") is None
    assert Frames().mount("base_link", "base_scan") is None


def test_frames_in_a_circle_are_nowhere() -> None:
    circle = frames(fixed("a", "b"), fixed("b", "a"), fixed("base", "laser"))
    assert circle.mount("base", "a") is None


def test_the_last_transform_counts_and_the_number_of_frames_is_limited() -> None:
    made = frames(*BURGER, fixed("base_link", "base_scan", 0.1))
    for k in range(MOST):
        made.on_tf_static(TFMessage([fixed("base_link", f"frame_{k}")]))
    found = made.mount("base_link", "base_scan")
    assert found is not None
    assert found.place[0] == pytest.approx(0.1)
    assert made.mount("base_link", f"frame_{MOST - 1}") is None


@pytest.mark.parametrize(
    "bad", [fixed("a", "b", nan), fixed("a", "b", turned=Quaternion(w=0.0))], ids=["nan", "none"]
)
def test_a_transform_that_is_none_is_refused(bad: TransformStamped) -> None:
    with pytest.raises(ValueError, match="rotation"):
        Frames().on_tf_static(TFMessage([bad]))


def test_mounts_differ_by_place_heading_and_which_way_is_up() -> None:
    ours = Mount((0.1, 0.0, pi))
    assert not ours.differs(Mount((0.11, 0.01, -pi + 0.01)))
    for other in (
        Mount((0.13, 0.0, pi)),
        Mount((0.1, 0.0, pi - 0.05)),
        Mount((0.1, 0.0, pi), upside_down=True),
    ):
        assert ours.differs(other)
