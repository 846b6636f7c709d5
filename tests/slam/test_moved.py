"""How a map moved: places keep their place beside what was mapped there, in one small message."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from armadico.agents.methods.poses import compose
from armadico.agents.slam.agent import map_moved
from armadico.core.messages import LARGEST_PAYLOAD, encode
from armadico.mobile.messages import MapMoved
from armadico.mobile.moving import moved

WAY = np.column_stack([np.linspace(0.0, 30.0, 101), np.zeros(101), np.zeros(101)])


def test_a_place_moves_with_the_key_scan_beside_it_and_the_first_stays() -> None:
    bent = WAY.copy()
    bent[:, 1] = np.linspace(0.0, 1.0, 101)
    bent[-1] = (30.0, 1.0, pi / 2)
    change = map_moved(2, WAY, bent)
    assert moved(change, 0.0, 0.0, 0.3) == pytest.approx((0.0, 0.0, 0.3))
    assert moved(change, 15.0, 2.0, 0.0) == pytest.approx((15.0, 2.5, 0.0), abs=0.03)
    last = MapMoved(2, change.places[-1:])
    assert moved(last, 31.0, 0.0, 0.0) == pytest.approx((30.0, 2.0, pi / 2))


def test_a_map_that_has_begun_anew_moves_nothing() -> None:
    assert moved(MapMoved(1), 3.0, 4.0, 5.0) == (3.0, 4.0, 5.0)


def test_a_large_map_fits_into_a_message() -> None:
    rng = np.random.default_rng(1)
    poses = np.column_stack([rng.uniform(0.0, 300.0, (20_000, 2)), np.zeros(20_000)])
    turned = compose(np.array([0.1, 0.2, 0.3]), poses)
    change = map_moved(9, poses, turned)
    assert len(encode(change)) < LARGEST_PAYLOAD / 2
    assert moved(change, 150.0, 150.0) == pytest.approx(
        compose(np.array([0.1, 0.2, 0.3]), np.array([150.0, 150.0, 0.0]))
    )
