"""Films of runs; ffmpeg is replaced by a script that stores its input."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from PIL import Image, ImageChops, ImageSequence

from armadico.config.profile import load_profile
from armadico.config.worlds import load_world

pytest.importorskip("matplotlib")

from armadico.watch.films import FRAMES_S, LASTS_S, RESTS_S, film_run
from armadico.watch.pictures import Run, Step, colour

BODY = load_profile("pioneer-2dx").body
WORLD = load_world("sc3")
FRAME = (960, 540)

DRIVEN: list[Step] = [
    (5.0 + i / 10, 1.0 + 0.05 * i, 0.5, 0.0, "goto" if i < 41 else "avoid") for i in range(81)
]

KEEPS = """\
#!/bin/sh
printf '%s\\n' "$@" > "$(dirname "$0")/arguments"
cat > "$(dirname "$0")/raw"
for last; do :; done
echo film > "$last"
"""


def made_up(steps: list[Step]) -> Run:
    return Run(steps, (1.0, 0.5, 0.0), (5.0, 0.5, 0.0), BODY, title="T", caption=["verdict"])


def rgb(holder: str | None) -> tuple[int, int, int]:
    code = colour(holder)
    return int(code[1:3], 16), int(code[3:5], 16), int(code[5:7], 16)


def count(frame: Image.Image, holder: str | None) -> int:
    """The number of pixels in a holder's colour, within the error of a palette."""
    found = frame.convert("RGB").getcolors(FRAME[0] * FRAME[1])
    assert found is not None
    wanted = rgb(holder)
    return sum(
        n
        for n, one in found
        if isinstance(one, tuple) and max(abs(a - b) for a, b in zip(wanted, one, strict=True)) <= 8
    )


@pytest.fixture(scope="module")
def gif(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Image.Image]:
    path = tmp_path_factory.mktemp("films") / "new folder" / "run.gif"
    film_run(WORLD, made_up(DRIVEN), path, speed=5.0)
    with Image.open(path) as opened:
        yield opened


@pytest.mark.long
def test_a_gif_has_the_duration_of_the_run_and_loops(gif: Image.Image) -> None:
    took = [frame.info["duration"] for frame in ImageSequence.Iterator(gif)]
    assert gif.size == FRAME
    assert gif.info["loop"] == 0
    whole = 8.0 / 5.0 + RESTS_S
    assert sum(took) / 1000 == pytest.approx(whole, abs=1 / FRAMES_S + 1e-6)
    assert took[-1] > took[0] == 1000 / FRAMES_S


def test_the_path_grows_in_its_holders_colours(gif: Image.Image) -> None:
    drawn = [frame.copy() for frame in ImageSequence.Iterator(gif)]
    first, half, last = drawn[0], drawn[len(drawn) // 2 - 1], drawn[-1]
    robot = count(first, "goto")  # the robot is filled with it, and the legend has both
    assert count(half, "goto") > count(first, "goto")
    assert count(last, "avoid") > count(first, "avoid") + 0.5 * robot
    reach = []
    for frame in (half, last):
        changed = ImageChops.difference(first.convert("RGB"), frame.convert("RGB"))
        plain = changed.convert("L").point([255 * (v > 30) for v in range(256)])  # not the palette
        box = plain.crop((0, 60, *FRAME)).getbbox()  # below the clock
        assert box is not None
        reach.append(box)
    assert reach[0][0] == reach[1][0]
    assert reach[0][2] < reach[1][2]


@pytest.mark.long
def test_a_long_run_is_accelerated_and_a_short_one_is_not_slowed_down(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armadico.watch.films.FRAMES_S", 1.25)  # fewer frames, for the test
    for name, seconds, lasts in (("short", 4.0, 4.0), ("long", 600.0, LASTS_S)):
        steps: list[Step] = [(seconds * i, 1.0 + i, 0.5, 0.0, "goto") for i in (0.0, 0.5, 1.0)]
        film_run(WORLD, made_up(steps), tmp_path / f"{name}.gif")
        with Image.open(tmp_path / f"{name}.gif") as film:
            took = sum(frame.info["duration"] for frame in ImageSequence.Iterator(film))
        assert took / 1000 == pytest.approx(lasts + RESTS_S, abs=1.0)


@pytest.mark.long
def test_a_run_that_never_began_is_a_still(tmp_path: Path) -> None:
    film_run(WORLD, made_up([]), tmp_path / "run.gif")
    with Image.open(tmp_path / "run.gif") as film:
        assert film.size == FRAME


@pytest.mark.parametrize(
    ("name", "speed", "named"),
    [
        ("run.avi", None, r"run\.avi.*\.gif.*\.mp4"),
        ("run", None, r"\.gif.*\.mp4"),
        ("run.gif", 0.0, "speed.*0"),
        ("run.gif", float("nan"), "speed.*nan"),
    ],
)
def test_another_ending_or_speed_is_refused(
    tmp_path: Path, name: str, speed: float | None, named: str
) -> None:
    with pytest.raises(ValueError, match=named):
        film_run(WORLD, made_up(DRIVEN), tmp_path / "new" / name, speed)
    assert not (tmp_path / "new").exists()


def test_without_ffmpeg_an_mp4_is_refused_and_a_gif_suggested(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(FileNotFoundError, match=r"ffmpeg.*run\.gif"):
        film_run(WORLD, made_up(DRIVEN), tmp_path / "new" / "run.mp4")
    assert not (tmp_path / "new").exists()


def ffmpeg(folder: Path, script: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a script as ffmpeg, first on the path."""
    folder.mkdir()
    program = folder / "ffmpeg"
    program.write_text(script)
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(folder), prepend=":")
    return folder


def test_an_mp4s_frames_go_to_ffmpeg(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    there = ffmpeg(tmp_path / "bin", KEEPS, monkeypatch)
    film_run(WORLD, made_up(DRIVEN), tmp_path / "run.mp4", speed=10.0)
    assert (tmp_path / "run.mp4").read_text() == "film\n"
    arguments = (there / "arguments").read_text().split("\n")
    assert arguments[arguments.index("-s") + 1] == "960x540"
    assert arguments[arguments.index("-framerate") + 1] == "12.5"
    frames, rest = divmod((there / "raw").stat().st_size, 4 * FRAME[0] * FRAME[1])
    assert rest == 0
    assert frames == round((0.8 + RESTS_S) * FRAMES_S)


@pytest.mark.parametrize("reads", ["", "cat > /dev/null; "])
def test_ffmpegs_error_is_quoted_and_an_incomplete_film_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reads: str
) -> None:
    out = tmp_path / "run.mp4"
    script = f"#!/bin/sh\n{reads}echo half > {out}\necho 'no encoder for it' >&2\nexit 1\n"
    ffmpeg(tmp_path / "bin", script, monkeypatch)
    with pytest.raises(OSError, match=r"run\.mp4: ffmpeg: no encoder for it"):
        film_run(WORLD, made_up(DRIVEN), out, speed=10.0)
    assert not out.exists()


@pytest.mark.long
def test_a_film_that_cannot_be_written_removes_nothing(tmp_path: Path) -> None:
    (tmp_path / "run.gif").mkdir()
    with pytest.raises(OSError, match="directory"):
        film_run(WORLD, made_up(DRIVEN), tmp_path / "run.gif")
    assert (tmp_path / "run.gif").is_dir()
