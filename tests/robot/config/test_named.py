"""Places by name: those of the map, and those that people add, in a file that survives them."""

from __future__ import annotations

import threading
from math import pi
from pathlib import Path

import pytest

from armadico.config.named import DATA_VARIABLE, Gazetteer, Sort
from armadico.config.shipped import find
from armadico.core.config_errors import ConfigError, ConfigNameError


@pytest.fixture(autouse=True)
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's data folder."""
    monkeypatch.setenv(DATA_VARIABLE, str(tmp_path / "data"))
    return tmp_path / "data"


def test_rooms_goals_and_docks_are_places() -> None:
    places = {place.name: place for place in Gazetteer("house").places}
    assert {name: place.sort for name, place in places.items()} == {
        **dict.fromkeys(("A", "B", "C", "D", "corridor"), Sort.ROOM),
        "E": Sort.GOAL,
        "dock": Sort.DOCK,
    }
    assert (places["E"].x, places["E"].y) == (12.6, 1.2)
    assert places["E"].heading == pytest.approx(-pi / 2)
    assert places["dock"].x == pytest.approx(0.83), "in front of it: the dock agent drives in"


def test_an_added_place_is_known_to_whoever_asks_next_and_removed_again() -> None:
    writer, reader = Gazetteer("house"), Gazetteer("house")
    writer.add('Süd "Küche"', (2.0, 1.5, pi / 2))
    writer.add("shelf", (2.0, 2.0, None))
    found = reader.of('süd "küche"')
    assert (found.name, found.sort, found.x, found.y) == ('Süd "Küche"', Sort.ADDED, 2.0, 1.5)
    assert found.heading == pytest.approx(pi / 2)
    assert reader.of("shelf").heading is None
    writer.remove("SHELF")
    with pytest.raises(ConfigNameError):
        reader.of("shelf")


def test_those_of_a_map_of_the_users_are_kept_beside_it(tmp_path: Path, data: Path) -> None:
    office = tmp_path / "office.map"
    office.write_bytes(find("worlds", "house").read_bytes())
    Gazetteer(str(office)).add("desk", (2.0, 1.5, None))
    assert (tmp_path / "office.places.toml").is_file()
    assert not data.exists()
    with pytest.raises(ConfigNameError):
        Gazetteer("house").of("desk")


def test_an_unknown_name_gets_the_nearest_one() -> None:
    with pytest.raises(ConfigNameError, match="did you mean 'corridor'"):
        Gazetteer("house").of("coridor")


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("", "1 to 60"),
        ("4x", "number"),
        ("here", "here"),
        ("a\nb", "printable"),
        (" a", "spaces"),
        ("corridor", "taken"),
    ],
)
def test_a_name_that_is_taken_or_cannot_be_typed_is_refused(name: str, why: str) -> None:
    gazetteer = Gazetteer("house")
    with pytest.raises(ConfigError, match=why):
        gazetteer.add(name, (2.0, 1.5, None))
    assert not gazetteer.file.exists()


@pytest.mark.parametrize(
    ("at", "why"),
    [
        ((float("nan"), 1.0, None), "finite"),
        ((1e9, 1.0, None), "finite"),
        ((20.0, 1.0, None), "outside"),
        ((4.6, 1.0, None), "wall"),
    ],
)
def test_no_place_is_added_where_there_is_none(
    at: tuple[float, float, float | None], why: str
) -> None:
    with pytest.raises(ConfigError, match=why):
        Gazetteer("house").add("x", at)


def test_places_of_the_map_are_not_removed() -> None:
    with pytest.raises(ConfigError, match="edit the map"):
        Gazetteer("house").remove("E")


@pytest.mark.parametrize(
    ("text", "why"),
    [("[a]\nx = 1\n", "y"), ("[a]\nx = 1\ny = 'b'\n", "places.toml:3"), ("[a", "places.toml:1")],
)
def test_a_damaged_file_is_named_with_the_line_and_not_overwritten(text: str, why: str) -> None:
    gazetteer = Gazetteer("house")
    gazetteer.file.parent.mkdir(parents=True)
    gazetteer.file.write_text(text)
    for use in (lambda: gazetteer.of("E"), lambda: gazetteer.add("x", (2.0, 1.5, None))):
        with pytest.raises(ConfigError, match=why):
            use()
    assert gazetteer.file.read_text() == text


def test_several_that_add_at_once_lose_nothing() -> None:
    names = [f"place-{number}" for number in range(8)]
    threads = [
        threading.Thread(target=Gazetteer("house").add, args=(name, (2.0, 1.5, None)))
        for name in names
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {place.name for place in Gazetteer("house").places} >= set(names)


def test_a_folder_with_the_name_of_a_file_is_called_a_folder(tmp_path: Path) -> None:
    folder = tmp_path / "fold.toml"
    folder.mkdir()
    with pytest.raises(ConfigNameError, match="is a folder") as raised:
        find("scenarios", folder)
    assert "did you mean" not in str(raised.value)
