"""ROS map_server maps: occupied cells become walls, in the right place."""

from __future__ import annotations

from math import cos, hypot, pi, sin
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from armadico.config.occupancy import _edges, walls_in
from armadico.config.worlds import load_world
from armadico.core.config_errors import ConfigError

YAML = """\
# made by a mapper
image: room.pgm
resolution: 0.5
origin: [-1.0, 2.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196   # not used
"""
# Rows as a picture shows them, the top one first: dark is occupied, 205 is unknown.
PICTURE = np.array([[254, 0, 0], [254, 254, 0], [205, 254, 254]], dtype=np.uint8)


def write(folder: Path, text: str = YAML) -> Path:
    Image.fromarray(PICTURE).save(folder / "room.pgm")
    file = folder / "room.yaml"
    file.write_text(text)
    return file


def test_the_border_of_occupied_cells_becomes_long_walls(tmp_path: Path) -> None:
    world = load_world(write(tmp_path))
    assert world.name == "room"
    assert world.bounds == (-1.0, 2.0, 0.5, 3.5)
    assert sorted(world.walls) == [
        (-0.5, 3.0, -0.5, 3.5),
        (-0.5, 3.0, 0.0, 3.0),
        (-0.5, 3.5, 0.5, 3.5),
        (0.0, 2.5, 0.0, 3.0),
        (0.0, 2.5, 0.5, 2.5),
        (0.5, 2.5, 0.5, 3.5),
    ]


@pytest.mark.parametrize("turn", [0.0, 0.3, pi / 2])
def test_nobody_stands_within_what_is_occupied(tmp_path: Path, turn: float) -> None:
    """However thick it is: its borders are walls, and what is between them is no room."""
    dark = np.full((12, 12), 254, dtype=np.uint8)
    dark[2:10, 2:10] = 0
    dark[5:7, 5:7] = 254  # a room that is shut up in it
    file = write(tmp_path, YAML.replace("0.0]", f"{turn}]"))
    Image.fromarray(dark).save(tmp_path / "room.pgm")
    world = load_world(file)
    for column, row, away in ((3.5, 3.5, 0.0), (3.5, 6.0, 0.0), (6.0, 6.0, 0.5), (1.0, 6.0, 0.5)):
        x, y = 0.5 * column, 0.5 * row
        at = -1.0 + cos(turn) * x - sin(turn) * y, 2.0 + sin(turn) * x + cos(turn) * y
        assert world.clearance(*at) == pytest.approx(away)


@given(hnp.arrays(np.bool_, hnp.array_shapes(min_dims=2, max_dims=2, max_side=8)))
def test_walls_are_as_long_as_the_border_and_stand_between_unlike_cells(
    cells: np.ndarray[tuple[int, int], np.dtype[np.bool_]],
) -> None:
    padded = np.pad(cells, 1)
    border = np.sum(padded[1:] != padded[:-1]) + np.sum(padded[:, 1:] != padded[:, :-1])
    edges = _edges(cells)
    assert walls_in(cells) == len(edges)
    assert sum(hypot(x2 - x1, y2 - y1) for x1, y1, x2, y2 in edges) == border
    for x1, y1, x2, y2 in edges:
        for column in range(x1, x2):
            assert padded[y1, column + 1] != padded[y1 + 1, column + 1]
        for row in range(y1, y2):
            assert padded[row + 1, x1] != padded[row + 1, x1 + 1]


@given(st.text())
def test_no_text_does_worse_than_a_config_error(
    tmp_path_factory: pytest.TempPathFactory, text: str
) -> None:
    folder = tmp_path_factory.mktemp("any")
    file = folder / "any.yaml"
    file.write_bytes(text.encode("utf-8", "replace"))
    with pytest.raises(ConfigError):
        load_world(file)


def test_a_picture_of_noise_is_no_map(tmp_path: Path) -> None:
    """It would fill the memory of every agent that is told the world."""
    file = write(tmp_path)
    noise = np.random.default_rng(1).integers(0, 255, (1000, 1000), dtype=np.uint8)
    Image.fromarray(noise).save(tmp_path / "room.pgm")
    with pytest.raises(ConfigError, match=r"room\.yaml: .*200,000"):
        load_world(file)
