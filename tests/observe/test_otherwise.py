"""What would have been decided otherwise: both utilities, both speeds, both paths."""

from __future__ import annotations

from itertools import pairwise
from math import hypot, isnan
from pathlib import Path

import pytest

pytest.importorskip("mcap")

from armadico import cli
from armadico.observe.otherwise import Seen, Wanted, other_path, wanted
from armadico.observe.recordings import Past
from armadico.observe.replay import Replay

from .test_replay import journal_of, record

SLOW = "v_max=0.2"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("otherwise") / "run.mcap")


def gone_through(recording: Path, *sets: str) -> tuple[Seen, Wanted]:
    past = Past(recording, pytest.fail)
    seen = Seen.of(past.rows(), "robot1", past.began)
    return seen, wanted(Replay(journal_of(recording, "goto"), sets), seen)


def test_with_nothing_set_both_are_the_same(recording: Path) -> None:
    seen, goto = gone_through(recording)
    then, now = dict(goto.speeds_then), dict(goto.speeds_now)
    both = [(then[t], now[t]) for t in then.keys() & now.keys()]
    assert all(a == b or (isnan(a) and isnan(b)) for a, b in both)
    driven = [pose for _, _, pose in seen.poses]
    other = other_path(seen, [goto])
    assert len(driven) == len(other) > 30
    assert max(hypot(a[0] - b[0], a[1] - b[1]) for a, b in zip(driven, other, strict=True)) < 1e-9


def test_set_slower_it_wants_less_and_comes_less_far(recording: Path) -> None:
    seen, goto = gone_through(recording, SLOW)
    assert max(v for _, v in goto.speeds_then if not isnan(v)) > 0.3
    assert max(v for _, v in goto.speeds_now if not isnan(v)) <= 0.2
    assert len(goto.utilities_then) == pytest.approx(len(goto.utilities_now), abs=2)

    def length(path: list[tuple[float, float, float]]) -> float:
        return sum(hypot(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(path))

    assert length(other_path(seen, [goto])) < length([pose for _, _, pose in seen.poses])


def test_of_nothing_there_is_no_path() -> None:
    assert other_path(Seen(0.0), []) == []


def test_it_is_drawn(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    picture = tmp_path / "otherwise.png"
    words = ["replay", str(recording), "--agent", "goto", "--set", SLOW, "--picture", str(picture)]
    assert cli.main(words) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert f"picture: {picture}" in capsys.readouterr().err
