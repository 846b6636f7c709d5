"""Which connection leaves when all places are taken."""

from __future__ import annotations

from armadico.watch.page.places import Places


def test_a_source_that_floods_displaces_its_own() -> None:
    places = Places[str](4)
    assert places.enter("person", "a") is None
    left = [places.enter(f"flood {n}", "b") for n in range(100)]
    assert "person" not in left
    assert places.enter("other", "c") == "flood 97"


def test_a_newcomer_gets_in_beside_many_sources() -> None:
    places = Places[str](50)
    for n in range(50):
        places.enter(f"flood {n}", f"s{n}")
    assert places.enter("person", "home") == "flood 0"


def test_a_higher_rank_keeps_its_place_and_takes_one_of_a_lower() -> None:
    places = Places[str](2)
    places.enter("holder", "a", rank=2)
    places.enter("viewer", "b")
    assert places.enter("near", "c", rank=1) == "viewer"
    assert places.enter("stranger", "d") == "stranger"
    assert places.enter("second", "e", rank=2) == "near"
    assert places.enter("third", "f", rank=2) == "holder"


def test_a_place_that_is_left_is_free() -> None:
    places = Places[str](1)
    places.enter("a", "s")
    places.leave("a")
    places.leave("a")
    assert places.enter("b", "s") is None
