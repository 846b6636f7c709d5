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
    "document marks": f"---\n{TEXT}...\n",
    "directive": f"%YAML 1.2\n---\n{TEXT}",
    "tabs": TEXT.replace(": ", ":\t"),
    "block": changed("[-1.0, -2.0, 0.0]", "\n- -1.0\n- -2.0\n- 0.0"),
    "over lines": changed("[-1.0, -2.0, 0.0]", "[-1.0,\n  -2.0,\n  0.0]"),
    "exponents": changed("[-1.0, -2.0, 0.0]", "[-1e0, -0.2e1, 0e0]"),
    "integers": changed("[-1.0, -2.0, 0.0]", "[-1, -2, 0]"),
    "comments": "# a map\n" + TEXT.replace("0.0]", "0.0] # yaw"),
    "quoted keys": "".join(f'"{line.replace(":", chr(34) + ":")}\n' for line in TEXT.splitlines()),
    "quoted numbers": changed("0.05", '"0.05"'),
    "flow": "{" + ", ".join(TEXT.splitlines()) + "}\n",
    "json": '{"image": "room.pgm", "resolution": 0.05, "origin": [-1, -2, 0], "negate": 0}',
    "tag": changed("0.05", "!!float 0.05"),
    "exponent": changed("0.05", "5e-2"),
    "alias": "cell: &cell 0.05\n" + changed("0.05", "*cell"),
    "other keys": f"{TEXT}cost: {{a: [1, 2]}}\n? [a, b]\n: c\n",
    "negate: False": changed("negate: 0", "negate: False"),
    "mode": f"{TEXT}mode: Trinary\n",
    "scale": f"{TEXT}mode: scale\n",
    "defaults": "".join(TEXT.splitlines(keepends=True)[:4]),
    "a threshold of 1": changed("0.65", "1.0"),
    "thresholds swapped": changed("0.65", "0.1").replace("free_thresh: 0.196", "free_thresh: 0.65"),
    "path": changed("room.pgm", "./sub/../room.pgm"),
    "absolute path": changed("room.pgm", "{folder}/room.pgm"),
    "a space": changed("room.pgm", "my map.pgm"),
    "a hash": changed("room.pgm", "a#1.pgm"),
    "a colon": changed("room.pgm", "a:1.pgm"),
}


@pytest.mark.parametrize("text", SAME.values(), ids=SAME)
def test_the_same_map_in_another_spelling(tmp_path: Path, text: str | bytes) -> None:
    walls = room(tmp_path)
    (tmp_path / "sub").mkdir()
    for name in ("my map.pgm", "a#1.pgm", "a:1.pgm"):
        Image.fromarray(ROOM).save(tmp_path / name)
    if isinstance(text, str):
        text = text.replace("{folder}", str(tmp_path))
    assert loaded(tmp_path, text) == walls


BOMB = "a: &a [x, x, x]\n" + "".join(
    f"{here}: &{here} [*{before}, *{before}, *{before}]\n"
    for before, here in zip("abcdefghij", "bcdefghijk", strict=True)
)

# What is wrong, and where the error is: the line, and the key if there is one.
WRONG: dict[str, tuple[str, str]] = {
    "nothing": ("", ":1: "),
    "a list": ("- image\n", ":1: "),
    "no resolution": (changed("resolution: 0.05\n", ""), ":1: missing key resolution"),
    "a key twice": (f"{TEXT}resolution: 0.1\n", ":7: "),
    "no colon": (f"{TEXT}negate\n", ":8: "),
    "not closed": (changed("0.0]", "0.0"), ":4: "),
    "deep": ("[" * 5000, ": "),
    "alias bomb": (BOMB + TEXT, ":2: "),
    "merge bomb": (f"a: &a {{x: 1}}\nb: {{<<: [*a, *a]}}\n{TEXT}", ":2: "),
    "contains itself": (f"a: &a [*a]\n{TEXT}", ":1: "),
    "binary": ("\0\1\2", ": "),
    "long": ("a: b\n" * 30_000, ": "),
    "resolution: text": (changed("0.05", "fine"), ":2: resolution: fine: "),
    "resolution: comma": (changed("0.05", "0,05"), ":2: resolution: 0,05: "),
    "resolution: unit": (changed("0.05", "0.05 m"), ":2: resolution: 0.05 m: "),
    "resolution: negative": (changed("0.05", "-0.05"), ":2: resolution: -0.05: "),
    "resolution: 20": (changed("0.05", "20"), ":2: resolution: 20: "),
    "resolution: list": (changed("0.05", "[0.05]"), ":2: resolution: [0.05]: "),
    "origin: two": (changed(", 0.0]", "]"), ":3: origin: "),
    "origin: six": (changed("0.0]", "0, 0, 0, 0]"), ":3: origin: "),
    "origin: number": (changed("[-1.0, -2.0, 0.0]", "5"), ":3: origin: 5: "),
    "origin: parentheses": (changed("[-1.0, -2.0, 0.0]", "(-1, -2, 0)"), ":3: origin: "),
    "origin: table": (changed("[-1.0, -2.0, 0.0]", "{x: -1, y: -2, yaw: 0}"), ":3: origin: {x"),
    "origin: nested": (changed("-1.0", "[1]"), ":3: origin: "),
    "origin: nan": (changed("0.0]", ".nan]"), ":3: origin: [-1.0, -2.0, .nan]: "),
    "origin: inf": (changed("-1.0", "-.inf"), ":3: origin: [-.inf, -2.0, 0.0]: "),
    "origin: utm": (changed("-1.0", "498532.25"), ":3: origin: [498532.25, "),
    "origin: far": (changed("-2.0", "-1e9"), ":3: origin: [-1.0, -1e9, "),
    "origin: edge": (changed("-1.0", "99995.0"), ":3: origin: [99995.0, "),
    "origin: degrees": (changed("0.0]", "90]"), ":3: origin: [-1.0, -2.0, 90]: "),
    "negate: text": (changed("negate: 0", "negate: maybe"), ":4: negate: maybe: "),
    "per cent": (changed("0.65", "65"), ":5: occupied_thresh: 65: "),
    "per cent free": (changed("0.196", "19.6"), ":6: free_thresh: 19.6: "),
    "a negative threshold": (changed("0.65", "-0.1"), ":5: occupied_thresh: -0.1: "),
    "a threshold of 0": (changed("0.65", "0"), ": "),
    "mode: text": (f"{TEXT}mode: best\n", ":7: mode: best: "),
    "image: other case": (changed("room.pgm", "ROOM.PGM"), ":1: image: ROOM.PGM: "),
    "image: home": (changed("room.pgm", "~/room.pgm"), ":1: image: ~/room.pgm: "),
    "image: url": (changed("room.pgm", "file://room.pgm"), ":1: image: file://room.pgm: "),
    "image: package": (changed("room.pgm", "package://a/room.pgm"), ":1: image: package:"),
    "image: backslash": (changed("room.pgm", "maps\\room.pgm"), ":1: image: maps\\room.pgm: "),
    "image: list": (changed("room.pgm", "[room.pgm]"), ":1: image: [room.pgm]: "),
    "image: none": (changed("room.pgm", ""), ":1: image: "),
    "image: folder": (changed("room.pgm", "."), ":1: image: .: "),
    "image: device": (changed("room.pgm", "/dev/zero"), ":1: image: /dev/zero: "),
    "image: too long": (changed("room.pgm", "x" * 300), ":1: image: xxx"),
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


def saved(pixels: Cells, **how: Any) -> Callable[[Path], None]:
    return lambda path: Image.fromarray(pixels).save(path, **how)


def palette(path: Path) -> None:
    Image.fromarray(ROOM).convert("RGB").quantize(4).save(path)


def keyed(path: Path) -> None:
    """A palette in which white is transparent."""
    image = Image.fromarray(WALL.astype(np.uint8))
    image.putpalette([255, 255, 255, 0, 0, 0])
    image.save(path, transparency=0)


def netpbm(head: str, pixels: Cells, *, plain: bool = False) -> Callable[[Path], None]:
    body = " ".join(map(str, pixels.ravel())).encode() if plain else pixels.tobytes()
    return lambda path: path.write_bytes(head.encode() + body) and None


def twelve(path: Path) -> None:
    """A TIFF of 12 bits, which Pillow does not write: two pixels are three bytes."""
    values = np.where(WALL, 200, 4095).reshape(-1, 2)
    a, b = values[:, 0], values[:, 1]
    data = np.stack([a >> 4, (a & 15) << 4 | b >> 8, b & 255], axis=1).astype(np.uint8).tobytes()
    tags = {256: 120, 257: 80, 258: 12, 259: 1, 262: 1, 273: 8, 277: 1, 278: 80, 279: len(data)}
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags.items())
    head = struct.pack("<2sHI", b"II", 42, 8 + len(data))
    path.write_bytes(head + data + struct.pack("<H", len(tags)) + entries + bytes(4))


SAME_IMAGES: dict[str, tuple[str, Callable[[Path], None]]] = {
    "pgm": ("a.pgm", saved(ROOM)),
    "pgm with comments": ("a.pgm", netpbm("P5 # by hand\n120 # width\n80\n# most\n255\n", ROOM)),
    "pgm in text": ("a.pgm", netpbm("P2\n120 80\n255\n", ROOM, plain=True)),
    "pgm of 100": ("a.pgm", netpbm("P5 120 80 100\n", ROOM // 3)),
    "pgm of 12 bits": (
        "a.pgm",
        netpbm("P5 120 80 4095\n", np.where(WALL, 200, 4095).astype(">u2")),
    ),
    "pgm of 16 bits": ("a.pgm", netpbm("P5 120 80 65535\n", DARK.astype(">u2"))),
    "pgm of 16 bits in text": ("a.pgm", netpbm("P2 120 80 65535\n", DARK, plain=True)),
    "pbm": ("a.pbm", saved(ROOM > 0)),
    "png": ("a.png", saved(ROOM)),
    "png of 1 bit": ("a.png", saved(ROOM > 0)),
    "png of 16 bits": ("a.png", saved(DARK)),
    "png with a palette": ("a.png", palette),
    "png with a clear colour": ("a.png", keyed),
    "png with alpha": ("a.png", saved(with_alpha((0, 0, 0, 255), (254, 254, 254, 255)))),
    "png of grey and alpha": ("a.png", saved(with_alpha((0, 255), (254, 255)))),
    "black on nothing": ("a.png", saved(with_alpha((0, 0, 0, 255), (0, 0, 0, 0)))),
    "black on clear white": ("a.png", saved(with_alpha((0, 0, 0, 255), (255, 255, 255, 0)))),
    "bmp": ("a.bmp", saved(ROOM)),
    "jpeg": ("a.jpg", saved(ROOM, quality=95)),
    "tiff": ("a.tif", saved(ROOM, compression="tiff_lzw")),
    "tiff of 12 bits": ("a.tif", twelve),
    "tiff of 16 bits": ("a.tif", saved(DARK)),
    "gif": ("a.gif", saved(ROOM)),
    "webp": ("a.webp", saved(ROOM, lossless=True)),
    "red": ("a.png", saved(coloured(255, 0, 0))),
    "green": ("a.png", saved(coloured(0, 255, 0))),
    "blue": ("a.png", saved(coloured(0, 0, 255))),
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
    "without pixels": b"P5\n0 0\n255\n",
    "git lfs": POINTER,
    "a program": b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EOF\n",
    "30,000 x 30,000": huge(30_000),
    "12,000 x 12,000": huge(12_000),
    "pgm of 30,000 x 30,000": b"P5\n30000 30000\n255\n",
    "floating point": b"Pf\n2 2\n-1.0\n" + bytes(16),
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
