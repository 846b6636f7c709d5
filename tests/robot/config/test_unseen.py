"""What nobody has seen of a map: read from its file, and laid over a planner's cells."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from armadico.config.nav2 import unseen_rule
from armadico.config.unseen import cells, distances, over, without_specks
from armadico.config.worlds import doubts, load_world
from armadico.core.config_errors import ConfigError


def saved(folder: Path, pixels: Any, **keys: Any) -> Path:
    """A map_server's map of an image, top row first, with cells of 5 cm."""
    values = np.asarray(pixels, dtype=np.uint8)
    Image.fromarray(values).save(folder / "map.png")
    about = {"image": "map.png", "resolution": 0.05, "origin": [0.0, 0.0, 0.0]} | keys
    file = folder / "map.yaml"
    file.write_text("\n".join(f"{key}: {value}" for key, value in about.items()))
    return file


def unseen(file: Path) -> list[list[int]]:
    found = load_world(file).unseen
    return [] if found is None else np.flipud(cells(found)).astype(int).tolist()


@pytest.mark.parametrize("mode", ["trinary", "scale"])
def test_grey_between_the_thresholds_is_unseen(tmp_path: Path, mode: str) -> None:
    file = saved(tmp_path, [[0, 205, 254], [254, 120, 254]], mode=mode)
    assert unseen(file) == [[0, 1, 0], [0, 1, 0]]


def test_raw_values_between_the_thresholds_and_above_100_are_unseen(tmp_path: Path) -> None:
    assert unseen(saved(tmp_path, [[0, 50, 100, 255]], mode="raw")) == [[0, 1, 0, 1]]


def test_what_is_transparent_is_unseen_whatever_its_shade(tmp_path: Path) -> None:
    pixels = [[(254, 254, 254, 255), (254, 254, 254, 0), (0, 0, 0, 0), (0, 0, 0, 255)]]
    assert unseen(saved(tmp_path, pixels)) == [[0, 1, 1, 0]]


def test_a_map_seen_as_a_whole_has_nothing_unseen(tmp_path: Path) -> None:
    assert load_world(saved(tmp_path, [[0, 254], [254, 254]])).unseen is None


def test_a_threshold_that_makes_the_savers_unknown_free_is_doubted(tmp_path: Path) -> None:
    file = saved(tmp_path, [[0, 205, 205, 254]], free_thresh=0.25)
    (doubt,) = doubts(str(file))
    assert doubt.startswith(f"{file}:4: free_thresh: 0.25: makes 2 cells of grey 205 free")
    assert "write 0.196" in doubt
    assert unseen(file) == []  # by this threshold it is free


@pytest.mark.parametrize(
    ("pixels", "keys"),
    [
        ([[0, 205, 254]], {"free_thresh": 0.196}),
        ([[0, 254, 254]], {"free_thresh": 0.25}),
        ([[255, 205, 0]], {"free_thresh": 0.25, "negate": 1}),
    ],
)
def test_other_maps_are_not_doubted(tmp_path: Path, pixels: Any, keys: dict[str, Any]) -> None:
    assert doubts(str(saved(tmp_path, pixels, **keys))) == ()


def test_a_maps_file_may_refuse_ways_through_the_unseen(tmp_path: Path) -> None:
    pixels = [[0, 205, 254]]
    for rule, refused in (("refuse", True), ("drive", False)):
        found = load_world(saved(tmp_path, pixels, unseen=rule)).unseen
        assert found is not None
        assert found.refused is refused
    with pytest.raises(ConfigError, match=r"4: unseen: never: expected one of drive, refuse"):
        load_world(saved(tmp_path, pixels, unseen="never"))


@pytest.mark.parametrize("cell_m", [0.02, 0.05, 0.2])
@pytest.mark.parametrize("turn", [0.0, 0.4, 1.57])
def test_it_lies_where_the_map_is_turned_to(tmp_path: Path, turn: float, cell_m: float) -> None:
    pixels = np.full((100, 60), 254)
    pixels[20:60, 30:50] = 205
    pixels[0, 0] = 0
    found = load_world(saved(tmp_path, pixels, origin=[1.0, -2.0, turn])).unseen
    assert found is not None
    c, s = np.cos(turn), np.sin(turn)
    for x, y, there in ((2.0, 3.0, True), (0.5, 3.0, False), (2.0, 1.0, False)):  # in the image
        at = np.array([1.0 + c * x - s * y]), np.array([-2.0 + s * x + c * y])
        assert bool(over(found, *at, cell_m)[0, 0]) is there
    assert over(found, np.array([-50.0]), np.array([0.0]), cell_m).all()  # off the map


def test_a_thin_line_of_a_fine_map_is_not_missed(tmp_path: Path) -> None:
    pixels = np.full((50, 50), 254)
    pixels[:, 20] = 120
    found = load_world(saved(tmp_path, pixels, resolution=0.01)).unseen
    assert found is not None
    at = np.arange(0.025, 0.5, 0.05)
    assert over(found, at, at, 0.05).any(axis=1).all()


def test_specks_count_as_seen_and_lines_do_not() -> None:
    mask = np.zeros((20, 20), dtype=np.bool_)
    mask[3, 3] = mask[8:10, 12:14] = True
    assert not without_specks(mask).any()
    mask[15, 2:9] = mask[0:3, 17] = True
    kept = np.zeros_like(mask)
    kept[15, 2:9] = kept[0:3, 17] = True
    assert (without_specks(mask) == kept).all()


def test_distances_are_those_to_the_nearest_cell() -> None:
    rng = np.random.default_rng(3)
    mask = rng.random((40, 30)) < 0.01
    rows, columns = np.nonzero(mask)
    y, x = np.mgrid[0:40, 0:30]
    away = np.hypot(y[..., None] - rows, x[..., None] - columns).min(axis=-1)
    expected = np.clip((away - 0.5) * 0.05, 0.0, 0.5)
    assert distances(mask, 0.05, 0.5) == pytest.approx(expected, abs=1e-6)
    assert (distances(np.zeros((3, 1), dtype=np.bool_), 0.05, 0.5) == 0.5).all()


NAV2 = """\
/robot1:
  planner_server:
    ros__parameters:
      planner_plugins: [GridBased]
      GridBased:
        plugin: nav2_navfn_planner::NavfnPlanner
        allow_unknown: {}
"""


def test_nav2s_parameters_tell_the_rule(tmp_path: Path) -> None:
    file = tmp_path / "nav2_params.yaml"
    for written, rule in (("true", "drive"), ("false", "refuse")):
        file.write_text(NAV2.format(written))
        assert unseen_rule(file) == rule
    file.write_text(NAV2.replace("        allow_unknown: {}\n", ""))
    assert unseen_rule(file) == "drive"  # Nav2's default


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (NAV2.format("maybe"), "allow_unknown: 'maybe': expected true or false"),
        ("image: map.pgm", "no key planner_server"),
        ("a: [", "not YAML"),
    ],
)
def test_other_files_are_not_nav2s(tmp_path: Path, text: str, why: str) -> None:
    file = tmp_path / "params.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=why):
        unseen_rule(file)
