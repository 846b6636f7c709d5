"""A run by a mechanism for which nobody competes says so, in words and in its JSON."""

from __future__ import annotations

import json
from importlib.util import find_spec

import pytest

from armadico.cli.run import main

PLAIN = (
    "--virtual",
    "--sensors",
    "ideal",
    *(("--no-plot",) if find_spec("armadico.watch") else ()),
)
AUCTION = (*PLAIN, "--coordination", "auction")


@pytest.mark.parametrize("more", [(), ("--redundant",)])
def test_an_auction_without_a_rival_says_that_it_decided_nothing(
    more: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["sc1", *AUCTION, *more, "--without", "avoid", "--without", "gothrough", "--json"]
    assert main(words) == 0
    found = capsys.readouterr()
    result = json.loads(found.out)
    assert result["contended"] == 0
    for text in (result["undecided"], found.err):
        assert "auction had nothing to decide: no two agents wanted wheels" in text


def test_an_auction_between_rivals_counts_their_cycles(capsys: pytest.CaptureFixture[str]) -> None:
    main(["sc4", *AUCTION, "--for", "20", "--json"])
    result = json.loads(capsys.readouterr().out)
    assert result["contended"] > 0
    assert result["undecided"] == ""


def test_a_mechanism_without_an_arbiter_is_counted_too(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("--coordination", "learned", "--parameters", "learned", "--for", "20", "--json")
    main(["sc4", *PLAIN, *words])
    assert json.loads(capsys.readouterr().out)["contended"] > 0
