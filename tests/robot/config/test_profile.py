"""A robot's profile says what it speaks, what it sees by, and how it moves; or an error says which
table is missing."""

from __future__ import annotations

from pathlib import Path

import pytest

from armadico.config.loading import find
from armadico.config.profile import load_profile
from armadico.core.config_errors import ConfigError, ConfigNameError


def without(text: str, table: str) -> str:
    """A profile's text without one of its tables."""
    begin = text.index(f"[{table}]")
    end = text.find("\n[", begin)
    return text[:begin] + (text[end + 1 :] if end >= 0 else "")


def written(folder: Path, text: str) -> Path:
    path = folder / "own.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("robot", "table", "message"),
    [
        ("pioneer-2dx", "motor", "motor"),
        ("pioneer-2dx", "caster", "caster"),
        ("pioneer-2dx", "p2os", "p2os"),
    ],
)
def test_a_table_that_is_missing_is_named(
    tmp_path: Path, robot: str, table: str, message: str
) -> None:
    path = written(tmp_path, without(find("robots", robot).read_text(), table))
    with pytest.raises(ConfigError, match=message):
        load_profile(path)


def test_a_table_that_is_of_no_use_is_named(tmp_path: Path) -> None:
    drive = """
[drive]
lag_s = 0.1
v_accel = 1.0
w_accel = 1.0
scrub = 0.0
heading = 1.0
rolling_n = 1.0
turning_nm = 1.0
efficiency = 0.5
"""
    path = written(tmp_path, find("robots", "pioneer-2dx").read_text() + drive)
    with pytest.raises(ConfigError, match=r"\[p2os\].*\[drive\]"):
        load_profile(path)


def test_an_array_of_tables_where_a_table_belongs_is_refused_with_its_line(tmp_path: Path) -> None:
    text = find("robots", "pioneer-2dx").read_text().replace("[p2os]", "[[p2os]]")
    line = text.splitlines().index("[[p2os]]") + 1
    with pytest.raises(ConfigError, match=rf":{line}: \[\[p2os\]\]"):
        load_profile(written(tmp_path, text))


@pytest.fixture
def foreign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package with kinds of robots that are none, and one that cannot be loaded."""
    info = tmp_path / "foreign-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: foreign\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[armadico.robots]\nchair = pathlib:Path\ngone = foreign.robot:KIND\n"
        "other = armadico.bridge.p2os_kind:P2OS\n"
    )
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.usefixtures("foreign")
@pytest.mark.parametrize(
    ("section", "message"),
    [
        ("chair", r":1: chair \(pathlib:Path\)"),
        ("gone", r":1: gone \(foreign.robot:KIND\)"),
        ("other", r":1: other .* 'p2os'"),
    ],
)
def test_an_entry_point_that_leads_to_no_kind_of_robot_is_named(
    tmp_path: Path, section: str, message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        load_profile(written(tmp_path, f"[{section}]\ncycle_s = 0.1\n"))


@pytest.mark.usefixtures("foreign")
def test_a_package_that_cannot_be_loaded_hides_no_other_profile() -> None:
    with pytest.raises(ConfigNameError) as caught:
        load_profile("amigobt")
    assert caught.value.near == "amigobot"
