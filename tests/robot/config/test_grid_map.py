"""Occupancy grids: through a message and through files, and what is none."""

from __future__ import annotations

import zlib
from errno import ENOSPC
from os import strerror
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray

from armadico.config import grid_map
from armadico.config.grid_map import FREE, OCCUPIED, UNKNOWN, Cells, cells_of, message_of
from armadico.config.worlds import load_world
from armadico.core.config_errors import ConfigError
from armadico.core.messages import LARGEST_PAYLOAD, decode, encode
from armadico.mobile.messages import OccupancyGrid
from armadico.observe.watching import as_object, from_object, json_schema

ROOM = np.array([[0, 2, 2, 0], [2, 1, 1, 2], [0, 2, 2, 2]], dtype=np.uint8)


def room(states: NDArray[np.uint8] = ROOM, cell_m: float = 0.5) -> Cells:
    return Cells(-1.0, 2.0, cell_m, states)


def same(one: Cells, other: Cells) -> bool:
    corner = (one.x, one.y, one.cell_m) == (other.x, other.y, other.cell_m)
    return corner and np.array_equal(one.states, other.states)


def test_a_grid_comes_out_of_a_message_as_it_went_in() -> None:
    sent = decode(encode(message_of(room())), OccupancyGrid)
    assert same(cells_of(sent), room())
    assert cells_of(message_of(grid_map.NOTHING)).states.size == 0


def test_what_does_not_fit_comes_in_larger_cells_and_keeps_what_is_occupied() -> None:
    states = np.random.default_rng(1).integers(0, 3, (1000, 1000), dtype=np.uint8)
    sent = message_of(room(states, 0.05))
    assert len(encode(sent)) <= LARGEST_PAYLOAD
    seen = cells_of(sent)
    times = round(seen.cell_m / 0.05)
    assert times > 1
    blocks = states[: 1000 // times * times, : 1000 // times * times]
    blocks = blocks.reshape(1000 // times, times, 1000 // times, times)
    inner = seen.states[: 1000 // times, : 1000 // times]
    assert np.array_equal(inner == OCCUPIED, (blocks == OCCUPIED).any(axis=(1, 3)))
    free = inner == FREE
    assert not (blocks == UNKNOWN).any(axis=(1, 3))[free].any()


@pytest.mark.parametrize(
    "packed",
    [b"", b"no", zlib.compress(b"\1" * 11), zlib.compress(b"\1" * 13), zlib.compress(b"\3" * 12)],
)
def test_what_is_no_grid_is_refused(packed: bytes) -> None:
    with pytest.raises(ValueError, match=r"cells"):
        cells_of(replace(message_of(room()), packed=packed))


def test_a_grid_too_large_to_be_read_is_refused_before_it_is_unpacked() -> None:
    with pytest.raises(ValueError, match="16,000,000"):
        cells_of(OccupancyGrid(0.0, 0.0, 0.05, 60_000, 60_000, b""))


@pytest.mark.parametrize("cell_m", [1e-300, 1e-6, 0.009])
def test_a_grid_of_cells_too_small_for_a_map_is_refused(cell_m: float) -> None:
    """Whoever planned on it would fill the memory, or divide by nothing."""
    with pytest.raises(ValueError, match=r"0\.01 m"):
        cells_of(replace(message_of(room()), cell=cell_m))


def test_a_grid_too_large_to_be_read_is_sent_in_larger_cells() -> None:
    sent = message_of(room(np.ones((4001, 4001), dtype=np.uint8), 0.05))
    assert cells_of(sent).cell_m == 0.1


def test_a_grid_is_recorded_and_read_back_with_its_bytes_as_text() -> None:
    message = message_of(room())
    plain = as_object(message)
    assert from_object(OccupancyGrid, plain) == message
    schema = json_schema(OccupancyGrid)
    assert schema["properties"].keys() >= plain.keys()
    assert "packed" not in schema["required"]


def test_a_map_servers_files_hold_all_of_it(tmp_path: Path) -> None:
    files = grid_map.save(room(), tmp_path / "room.yaml")
    assert [file.name for file in files] == ["room.yaml", "room.pgm"]
    assert same(grid_map.read(tmp_path / "room.yaml"), room())


@pytest.mark.parametrize(
    "name",
    [
        "x #1",
        '"q"',
        "a: b",
        "  a",
        'it\'s "a" # b',
        "a\nb",
        "grün 地図",
    ],
)
def test_whatever_a_map_is_called_its_image_is_found(tmp_path: Path, name: str) -> None:
    path = tmp_path / f"{name}.yaml"
    grid_map.save(room(), path)
    assert same(grid_map.read(path), room())


def test_both_kinds_of_file_are_the_same_world(tmp_path: Path) -> None:
    for name in ("room.yaml", "room.map"):
        grid_map.save(room(), tmp_path / name)
    ros, aria = (load_world(tmp_path / name) for name in ("room.yaml", "room.map"))
    assert sorted(ros.walls) == sorted(aria.walls)
    assert ros.bounds == aria.bounds == room().bounds
    assert load_world(tmp_path / "room.map").clearance(-0.25, 2.75) == pytest.approx(0.25)


@pytest.mark.parametrize("name", ["room.yaml", "room.map"])
def test_a_map_that_does_not_fit_on_the_disk_leaves_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    before = {file: file.read_bytes() for file in grid_map.save(room(), tmp_path / name)}
    write = Path.write_bytes

    def full(path: Path, data: bytes) -> int:
        write(path, data[:20])
        raise OSError(ENOSPC, strerror(ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space"):
        grid_map.save(room(cell_m=1.0), tmp_path / name)
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_where_a_folder_is_no_map_is_written_nor_half_of_one(tmp_path: Path) -> None:
    (tmp_path / "room.yaml").mkdir()
    for attempt in (lambda file: grid_map.save(room(), file), grid_map.check_writable):
        with pytest.raises(IsADirectoryError):
            attempt(tmp_path / "room.yaml")
    assert [file.name for file in tmp_path.iterdir()] == ["room.yaml"]


@pytest.mark.parametrize("protected", ["a.yaml", "a.pgm"])
def test_a_file_that_is_read_only_is_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, protected: str
) -> None:
    """To rename another over it takes a right to the folder only."""
    path = tmp_path / "a.yaml"
    grid_map.save(room(), path)
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    monkeypatch.setattr("os.access", lambda file, _: Path(file).name != protected)  # as root, too
    for refuses in (grid_map.check_writable, lambda file: grid_map.save(room(cell_m=1.0), file)):
        with pytest.raises(PermissionError):
            refuses(path)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_a_map_that_is_turned_is_not_gone_on_with(tmp_path: Path) -> None:
    file, _ = grid_map.save(room(), tmp_path / "room.yaml")
    file.write_text(file.read_text().replace(", 0.0]", ", 0.5]"))
    with pytest.raises(ConfigError, match=r"0\.5 rad"):
        grid_map.read(file)
