"""Maps of map_server as other people and other programs write them: what they yield, or why not."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from armadico.config.worlds import load_world
from armadico.core.config_errors import ConfigError

TEXT = """\
image: room.pgm
resolution: 0.05
origin: [-1.0, -2.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""

Cells = NDArray[Any]

ROOM: Cells = np.full((80, 120), 254, dtype=np.uint8)  # 6 m x 4 m, and a partition with a gap
ROOM[:2] = ROOM[-2:] = ROOM[:, :2] = ROOM[:, -2:] = ROOM[:50, 58:61] = 0


def loaded(folder: Path, text: str | bytes) -> list[tuple[float, ...]]:
    """The walls of a map in a folder, in millimetres."""
    file = folder / "map.yaml"
    file.write_bytes(text.encode() if isinstance(text, str) else text)
    world = load_world(file)
    return sorted(tuple(round(1000.0 * value) for value in wall) for wall in world.walls)


def room(folder: Path) -> list[tuple[float, ...]]:
    """The walls of the room from a plain map."""
    Image.fromarray(ROOM).save(folder / "room.pgm")
    walls = loaded(folder, TEXT)
    assert len(walls) == 12
    return walls


def changed(old: str, new: str) -> str:
    assert old in TEXT
    return TEXT.replace(old, new, 1)


SAME: dict[str, str | bytes] = {
    "plain": TEXT,
    "windows": TEXT.replace("\n", "\r\n"),
    "old mac": TEXT.replace("\n", "\r"),
    "byte order mark": b"\xef\xbb\xbf" + TEXT.encode(),
    "utf-16": TEXT.encode("utf-16"),
    "tabs": TEXT.replace(": ", ":\t"),
    "quoted numbers": changed("0.05", '"0.05"'),
    "tag": changed("0.05", "!!float 0.05"),
    "alias": "cell: &cell 0.05\n" + changed("0.05", "*cell"),
    "other keys": f"{TEXT}cost: {{a: [1, 2]}}\n? [a, b]\n: c\n",
    "scale": f"{TEXT}mode: scale\n",
    "defaults": "".join(TEXT.splitlines(keepends=True)[:4]),
    "thresholds swapped": changed("0.65", "0.1").replace("free_thresh: 0.196", "free_thresh: 0.65"),
}


@pytest.mark.parametrize("text", SAME.values(), ids=SAME)
def test_the_same_map_in_another_spelling(tmp_path: Path, text: str | bytes) -> None:
    walls = room(tmp_path)
    assert loaded(tmp_path, text) == walls


BOMB = "a: &a [x, x, x]\n" + "".join(
    f"{here}: &{here} [*{before}, *{before}, *{before}]\n"
    for before, here in zip("abcdefghij", "bcdefghijk", strict=True)
)

# What is wrong, and where the error is: the line, and the key if there is one.
WRONG: dict[str, tuple[str, str]] = {
    "nothing": ("", ":1: "),
    "no resolution": (changed("resolution: 0.05\n", ""), ":1: missing key resolution"),
    "a key twice": (f"{TEXT}resolution: 0.1\n", ":7: "),
    "deep": ("[" * 5000, ": "),
    "alias bomb": (BOMB + TEXT, ":2: "),
    "merge bomb": (f"a: &a {{x: 1}}\nb: {{<<: [*a, *a]}}\n{TEXT}", ":2: "),
    "binary": ("\0\1\2", ": "),
    "long": ("a: b\n" * 30_000, ": "),
    "resolution: text": (changed("0.05", "fine"), ":2: resolution: fine: "),
    "resolution: negative": (changed("0.05", "-0.05"), ":2: resolution: -0.05: "),
    "origin: two": (changed(", 0.0]", "]"), ":3: origin: "),
    "origin: nan": (changed("0.0]", ".nan]"), ":3: origin: [-1.0, -2.0, .nan]: "),
    "origin: utm": (changed("-1.0", "498532.25"), ":3: origin: [498532.25, "),
    "origin: far": (changed("-2.0", "-1e9"), ":3: origin: [-1.0, -1e9, "),
    "origin: degrees": (changed("0.0]", "90]"), ":3: origin: [-1.0, -2.0, 90]: "),
    "negate: text": (changed("negate: 0", "negate: maybe"), ":4: negate: maybe: "),
    "per cent": (changed("0.65", "65"), ":5: occupied_thresh: 65: "),
    "a threshold of 0": (changed("0.65", "0"), ": "),
    "mode: text": (f"{TEXT}mode: best\n", ":7: mode: best: "),
    "image: other case": (changed("room.pgm", "ROOM.PGM"), ":1: image: ROOM.PGM: "),
    "image: folder": (changed("room.pgm", "."), ":1: image: .: "),
    "image: device": (changed("room.pgm", "/dev/zero"), ":1: image: /dev/zero: "),
    "image: text": (changed("room.pgm", "map.yaml"), ":1: image: map.yaml: "),
}


@pytest.mark.parametrize(("text", "place"), WRONG.values(), ids=WRONG)
def test_what_is_no_map_is_an_error_that_names_its_place(
    tmp_path: Path, text: str, place: str
) -> None:
    room(tmp_path)
    with pytest.raises(ConfigError) as caught:
        loaded(tmp_path, text)
    assert str(caught.value).startswith(f"{tmp_path / 'map.yaml'}{place}")


# Images ------------------------------------------------------------------------------------------

WALL = ROOM == 0
DARK = np.where(WALL, 3277, 65535).astype(np.uint16)  # walls of 5 % grey in 16 bits


def coloured(red: int, green: int, blue: int) -> Cells:
    return np.where(WALL[..., None], np.array([red, green, blue]), 254).astype(np.uint8)


def with_alpha(wall: tuple[int, ...], other: tuple[int, ...]) -> Cells:
    return np.where(WALL[..., None], np.array(wall), np.array(other)).astype(np.uint8)


def saved(pixels: Cells) -> Callable[[Path], None]:
    return lambda path: Image.fromarray(pixels).save(path)


def palette(path: Path) -> None:
    Image.fromarray(ROOM).convert("RGB").quantize(4).save(path)


SAME_IMAGES: dict[str, tuple[str, Callable[[Path], None]]] = {
    "pgm": ("a.pgm", saved(ROOM)),
    "pgm of 16 bits": ("a.pgm", saved(DARK)),
    "pbm": ("a.pbm", saved(ROOM > 0)),
    "png of 16 bits": ("a.png", saved(DARK)),
    "png with a palette": ("a.png", palette),
    "png with alpha": ("a.png", saved(with_alpha((0, 0, 0, 255), (254, 254, 254, 255)))),
    "black on nothing": ("a.png", saved(with_alpha((0, 0, 0, 255), (0, 0, 0, 0)))),
    "orange": ("a.png", saved(coloured(200, 60, 0))),
}


@pytest.mark.parametrize(("name", "write"), SAME_IMAGES.values(), ids=SAME_IMAGES)
def test_the_same_map_as_another_image(
    tmp_path: Path, name: str, write: Callable[[Path], None]
) -> None:
    walls = room(tmp_path)
    write(tmp_path / name)
    assert loaded(tmp_path, changed("room.pgm", name)) == walls


# The grey of one cell, the keys that judge it, and whether it is a wall; beside it all is free.
JUDGED: list[tuple[int | tuple[int, ...], str, bool]] = [
    (51, "occupied_thresh: 0.8\n", True),  # a threshold belongs to what is occupied
    (52, "occupied_thresh: 0.8\n", False),
    (204, "negate: 1\noccupied_thresh: 0.8\n", True),
    (203, "negate: 1\noccupied_thresh: 0.8\n", False),
    ((0, 255, 0), "", True),  # the mean of the channels is 1/3
    ((90, 90, 90), "", False),
    ((0, 0, 0, 254), "", False),  # what is not opaque is unknown
    ((0, 0, 0, 254), "mode: scale\n", False),
    ((100, 100, 100, 0), "mode: raw\n", True),  # in raw there is no alpha, and no negate
    (100, "mode: raw\nnegate: 1\n", True),
    (65, "mode: raw\n", True),
    (64, "mode: raw\n", False),
    (101, "mode: raw\n", False),  # more than 100 is unknown
]


@pytest.mark.parametrize(("grey", "keys", "wall"), JUDGED)
def test_a_cell_is_judged_as_map_server_does(
    tmp_path: Path, grey: int | tuple[int, ...], keys: str, wall: bool
) -> None:
    free = 0 if "raw" in keys or "negate" in keys else 255
    pixels = np.full((3, 3, *np.shape(grey)), free, dtype=np.uint8)
    if np.shape(grey) == (4,):
        pixels[..., 3] = 255
    pixels[1, 1] = grey
    Image.fromarray(pixels).save(tmp_path / "a.png")
    text = f"image: a.png\nresolution: 1\norigin: [0, 0, 0]\n{keys}"
    assert len(loaded(tmp_path, text)) == (4 if wall else 0)


def huge(side: int) -> bytes:
    """A PNG that announces more pixels than it has."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        check = struct.pack(">I", zlib.crc32(kind + data))
        return struct.pack(">I", len(data)) + kind + data + check

    head = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(99)))


POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:abc\nsize 9600\n"

NO_IMAGES: dict[str, bytes] = {
    "empty": b"",
    "text": b"not an image",
    "cut": b"P5\n120 80\n255\n" + bytes(4000),
    "git lfs": POINTER,
    "30,000 x 30,000": huge(30_000),
    "pgm of 30,000 x 30,000": b"P5\n30000 30000\n255\n",
}


@pytest.mark.parametrize("data", NO_IMAGES.values(), ids=NO_IMAGES)
def test_what_is_no_image_is_an_error_that_names_it(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "room.pgm").write_bytes(data)
    with pytest.raises(ConfigError) as caught:
        loaded(tmp_path, TEXT)
    assert str(caught.value).startswith(f"{tmp_path / 'map.yaml'}:1: image: room.pgm: ")


@pytest.mark.parametrize(("grey", "walls"), [(254, 0), (205, None), (0, None)])
def test_a_map_of_one_shade_is_a_map_only_if_it_is_free(
    tmp_path: Path, grey: int, walls: int | None
) -> None:
    Image.fromarray(np.full((9, 9), grey, dtype=np.uint8)).save(tmp_path / "room.pgm")
    if walls is not None:
        assert len(loaded(tmp_path, TEXT)) == walls
        return
    with pytest.raises(ConfigError, match=r"map\.yaml: "):
        loaded(tmp_path, TEXT)
