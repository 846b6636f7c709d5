"""Every error names the file, the line, what stands there and what would be right."""

from __future__ import annotations

import pickle
import re
from pathlib import Path
from typing import Annotated, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Meta, Struct

from armadico.bridge.p2os.profile import P2osRobot
from armadico.config.lines import line_of
from armadico.config.loading import (
    find,
    load,
    load_entry,
    load_parameters,
    load_table,
    names,
    parse,
    set_values,
)
from armadico.config.profile import SensorProfile
from armadico.core.config_errors import ConfigError, ConfigNameError, ConfigValueError
from tests.robot.robots import LASER


class Zones(Struct, frozen=True):
    stop: Annotated[float, Meta(gt=0)] = 0.1
    caution: float = 0.5


class Sonar(Struct, frozen=True, forbid_unknown_fields=True):
    x_m: float
    bearing_deg: Annotated[float, Meta(ge=-180, le=180)] = 0.0


class Settings(Struct, frozen=True):
    name: str
    zones: Zones = Zones()
    sonars: tuple[Sonar, ...] = ()
    mode: Literal["fast", "precise"] = "fast"
    limit: float | None = None
    count: int = 3
    on: bool = False


GOOD = """\
name = "one"   # a comment
count = 4

[zones]
stop = 0.2
"""


def refused(text: str) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        parse(text, Settings, "some.toml")
    return caught.value


def test_a_good_text_becomes_the_struct() -> None:
    expected = Settings(name="one", count=4, zones=Zones(stop=0.2))
    assert parse(GOOD, Settings) == expected


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("name = \n", 1),
        ('name = "a"\n\nname = "b"\n', 3),
        ('count = 1\nname = """a', 2),
        ("count = 1", None),
        ('name = "a"\n[[sonars]]\nx_m = 1\n[[sonars]]\nbearing_deg = 1\n', 4),
    ],
)
def test_what_is_not_toml_or_lacks_a_key_is_named_with_its_line(
    text: str, line: int | None
) -> None:
    error = refused(text)
    assert (error.file, error.line) == ("some.toml", line)
    assert str(error).startswith("some.toml:")


@pytest.mark.parametrize(
    ("text", "line", "key", "value"),
    [
        ("name = 3", 1, "name", 3),
        ('name = "a"\n[zones]\nstop = "x"', 3, "zones.stop", "x"),
        ('name = "a"\nzones.stop = -1.5', 2, "zones.stop", -1.5),
        ('name = "a"\nzones = { stop = 0 }', 2, "zones.stop", 0),
        ('name = "a"\non = 1', 2, "on", 1),
        (
            'name = "a"\nsonars = [\n  # one\n  { x_m = 1 },\n  { x_m = 1, bearing_deg = 181 },\n]',
            5,
            "sonars[1].bearing_deg",
            181,
        ),
    ],
)
def test_a_wrong_value_is_named_with_its_line_and_key(
    text: str, line: int, key: str, value: object
) -> None:
    error = refused(text)
    assert isinstance(error, ConfigValueError)
    assert (error.file, error.line, error.key, error.value) == ("some.toml", line, key, value)


@pytest.mark.parametrize(
    ("text", "line", "name", "near", "known"),
    [
        ('name = "a"\n[zone]\nstop = 1', 2, "zone", "zones", 7),
        ('name = "a"\n[zones]\n# stp = 1\nstp = 1', 4, "stp", "stop", 2),
        ('name = "a"\nmode = "Precise"', 2, "Precise", "precise", 2),
        ('name = "a"\n[[sonars]]\nx_m = 1\n[[sonars]]\ny_m = 1\n', 5, "y_m", "x_m", 2),
    ],
)
def test_an_unknown_key_or_word_is_named_with_the_nearest(
    text: str, line: int, name: str, near: str, known: int
) -> None:
    error = refused(text)
    assert isinstance(error, ConfigNameError)
    assert (error.line, error.name, error.near, len(error.known)) == (line, name, near, known)


@pytest.mark.parametrize("text", ["name = 3", 'name = "a"\n[zone]\nstop = 1', "count = 1"])
def test_an_error_survives_a_process_and_another_place(text: str) -> None:
    """Workers of `armadico run --runs` send errors back."""
    error = refused(text)
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again)) == (type(error), str(error))
    moved = again.at("other.toml", 9, "goto: ")
    assert str(moved) == f"other.toml:9: goto: {error.message}"
    assert vars(moved) | {"message": "", "file": "", "line": 0} == vars(error) | {
        "message": "",
        "file": "",
        "line": 0,
    }


def test_a_file_that_is_not_there_or_no_text_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.toml: "):
        load(tmp_path / "none.toml", Settings)
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xff")
    with pytest.raises(ConfigError, match=r"bytes\.toml: .*UTF-8"):
        load(tmp_path / "bytes.toml", Settings)


@pytest.mark.parametrize("coded", ["utf-8", "utf-8-sig", "utf-16"])
def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path, coded: str) -> None:
    (tmp_path / "a.toml").write_bytes('name = "grün"\r\n'.encode(coded))
    assert load(tmp_path / "a.toml", Settings).name == "grün"


@given(
    st.lists(st.text("abcxyz-_0", min_size=1, max_size=6), min_size=1, max_size=4, unique=True),
    st.integers(0, 3),
)
def test_the_line_of_any_key_in_any_table_is_found(tables: list[str], blank: int) -> None:
    text = ""
    lines: dict[tuple[str, ...], int] = {}
    for table in tables:
        text += f"[{table}]\n" + "# x = 2\n" * blank + "x = 1\n" + "\n" * blank
        lines[table, "x"] = text.rstrip("\n").count("\n") + 1
    for path, line in lines.items():
        assert line_of(text, path) == line
    assert line_of(text, ("no such key",)) is None


# --- settings on a command line


def test_settings_are_typed_by_the_struct() -> None:
    changed = set_values(
        Settings(name="one", limit=1.0),
        ["name=tcp:host", "zones.stop=1", "count = 7", "on=true", "limit=none", "mode=precise"],
    )
    assert changed == Settings(
        name="tcp:host", zones=Zones(stop=1.0), count=7, on=True, mode="precise"
    )


def test_a_string_that_reads_as_something_else_stays_a_string() -> None:
    assert set_values(Settings(name="one"), ["name=12"]).name == "12"
    assert set_values(Settings(name="one"), ["name=none"]).name == "none"


@pytest.mark.parametrize(
    ("setting", "kind"),
    [
        ("stop", ConfigError),
        ("=3", ConfigError),
        ("zones.stop=0", ConfigValueError),
        ("zones.stop=far", ConfigValueError),
        ("zones.Stop=1", ConfigNameError),
        ("mode=faster", ConfigNameError),
        ("count=1.5", ConfigValueError),
    ],
)
def test_a_wrong_setting_is_quoted(setting: str, kind: type[ConfigError]) -> None:
    with pytest.raises(ConfigError) as caught:
        set_values(Settings(name="one"), [setting])
    assert type(caught.value) is kind
    assert str(caught.value).startswith(f"--set {setting}: ")


def test_parameters_are_defaults_then_a_file_then_settings(tmp_path: Path) -> None:
    file = tmp_path / "goto.toml"
    file.write_text("stop = 0.3\ncaution = 0.7\n")
    assert load_parameters(Zones, None, []) == Zones()
    assert load_parameters(Zones, file, ["stop=0.4"]) == Zones(stop=0.4, caution=0.7)
    with pytest.raises(ConfigError, match="missing key name"):
        load_parameters(Settings, None, [])


# --- what is shipped


class Cat(Struct, frozen=True, tag_field="is", tag="cat"):
    lives: int = 9


class Dog(Struct, frozen=True, tag_field="is", tag="dog", rename={"legs": "leg-count"}):
    legs: int = 4


class House(Struct, frozen=True):
    pets: dict[str, Cat | Dog] = {}


def test_what_a_dict_or_a_tagged_struct_holds_is_checked_too() -> None:
    kept = parse('[pets.a]\nis = "cat"\n[pets.b]\nis = "dog"\nleg-count = 3', House)
    assert kept == House({"a": Cat(), "b": Dog(3)})
    with pytest.raises(ConfigError, match=r"some\.toml:5: unknown key pets\.b\.legs"):
        parse('[pets.a]\nis = "cat"\n[pets.b]\nis = "dog"\nlegs = 3', House, "some.toml")


@pytest.mark.parametrize(
    "key", ["wheel_radius_m", "trail_m", "resistance_ohm", "period_s", "diff_conv"]
)
def test_what_is_divided_by_is_not_too_small_for_that(tmp_path: Path, key: str) -> None:
    text = find("robots", "pioneer-2dx").read_text()
    path = tmp_path / "own.toml"
    path.write_text(re.sub(rf"^{key} *=.*", f"{key} = 1e-300", text, flags=re.MULTILINE))
    with pytest.raises(ConfigError, match=rf"{key} = 1e-300: expected a number >= "):
        load(path, P2osRobot)


@pytest.mark.parametrize(
    ("written", "instead", "message"),
    [
        ("max_m = 30.0", "max_m = 0.1", "min_m.*max_m"),
        ("max_m = 30.0", "max_m = 66.0", "max_m = 66.0: expected a number <= 65.534"),
        ("rays = 720", "rays = 2049", "rays = 2049: expected"),
        ("rays = 720", "rays = 1", "rays = 1: expected"),
        (
            "angle_max_deg = 135.0",
            "angle_max_deg = -135.0",
            "angle_max_deg",
        ),
        ("angle_max_deg = 135.0", "angle_max_deg = 230.0", "angle_max_deg"),
        ("rate_hz = 40.0", "rate_hz = 0.0", "rate_hz = 0.0: expected a number >= 1"),
    ],
)
def test_a_laser_that_no_one_has_is_refused(
    tmp_path: Path, written: str, instead: str, message: str
) -> None:
    path = tmp_path / "own.toml"
    laser = LASER.replace(written, instead)
    path.write_text(find("robots", "pioneer-2dx").read_text() + laser)
    with pytest.raises(ConfigError, match=message):
        load(path, P2osRobot)


def test_sensors_are_entries_of_one_file_and_no_robots() -> None:
    file = find("robots", "sensors")
    assert "sensors" not in names("robots")
    assert load_entry(file, SensorProfile, "real").name == "real"
    with pytest.raises(ConfigNameError) as caught:
        load_entry(file, SensorProfile, "rael")
    assert (caught.value.file, caught.value.near) == (str(file), "real")


def test_an_entry_of_a_table_is_named_with_its_line(tmp_path: Path) -> None:
    file = tmp_path / "zones.toml"
    file.write_text("[near]\nstop = 1\n[far]\nstop = 0\n")
    with pytest.raises(ConfigValueError) as caught:
        load_table(file, Zones)
    assert (caught.value.line, caught.value.key, caught.value.value) == (4, "far.stop", 0)


def test_an_unknown_name_has_what_there_is_and_the_nearest() -> None:
    with pytest.raises(ConfigNameError) as caught:
        find("robots", "pioneer2dx")
    error = caught.value
    assert (error.kind, error.name, error.near) == ("robot", "pioneer2dx", "pioneer-2dx")
    assert error.known == tuple(names("robots"))


def test_a_slash_or_a_suffix_is_a_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.touch()
    assert find("robots", str(file)) == file
    with pytest.raises(ConfigNameError) as caught:
        find("robots", str(tmp_path / "mind.toml"))
    assert caught.value.near == "mine.toml"
    with pytest.raises(ConfigNameError, match="amigobot, create3, jackal, "):
        find("robots", str(tmp_path / "nowhere" / "x.toml"))
