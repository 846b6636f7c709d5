"""Pictures of runs and worlds: their size, colours and content."""

from __future__ import annotations

from math import pi
from pathlib import Path

import pytest
from PIL import Image

from armadico.config.profile import load_profile
from armadico.config.worlds import load_world

pytest.importorskip("matplotlib")

from armadico.watch.pictures import (
    Run,
    Step,
    _tenures,
    colour,
    draw_run,
)

BODY = load_profile("pioneer-2dx").body

STRAIGHT: list[Step] = [
    (i / 10, 1.0 + 0.05 * i, 0.5, 0.0, "goto" if i < 40 else "avoid") for i in range(81)
]


def pixels(path: Path) -> set[tuple[int, int, int]]:
    with Image.open(path) as image:
        assert image.size == (1280, 720)
        colours = image.convert("RGB").getcolors(1280 * 720)
    assert colours is not None
    return {(r, g, b) for _, (r, g, b) in colours}  # type: ignore[misc]


def rgb(name: str | None) -> tuple[int, int, int]:
    code = colour(name)
    return int(code[1:3], 16), int(code[3:5], 16), int(code[5:7], 16)


def near(wanted: tuple[int, int, int], seen: set[tuple[int, int, int]]) -> bool:
    """Whether a colour is in the picture, within the error of its palette."""
    return any(max(abs(a - b) for a, b in zip(wanted, one, strict=True)) <= 8 for one in seen)


def test_a_run_is_drawn_in_its_holders_colours(tmp_path: Path) -> None:
    waypoints, echoes = [(3.0, 0.5, 0.0)], [(2.0, 0.0)] * 9
    start, goal = (1.0, 0.5, 0.0), (5.0, 0.5, pi)
    run = Run(STRAIGHT, start, goal, BODY, waypoints, echoes, "T", ["c"])
    draw_run(load_world("sc3"), run, tmp_path / "new folder" / "run.png")
    seen = pixels(tmp_path / "new folder" / "run.png")
    assert near(rgb("goto"), seen)
    assert near(rgb("avoid"), seen)
    assert not near(rgb("gothrough"), seen)


def test_a_path_is_split_at_exchanges_without_gaps() -> None:
    tenures = list(_tenures(STRAIGHT))
    assert [holder for holder, _ in tenures] == ["goto", "avoid"]
    assert tenures[0][1][-1] == tenures[1][1][0]
    assert sum(len(points) for _, points in tenures) == len(STRAIGHT) + 1
