"""The policy file: what is wrong in it is named, and what it has is what counts."""

from __future__ import annotations

import json
from datetime import datetime
from math import cos, pi, sin
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.config.shipped import find, names
from armadico.config.worlds import load_world
from armadico.core.config_errors import ConfigError
from armadico.watch.assistant.policy.policy import load, read
from tests.watch.test_assistant import Counter

WORLD = load_world("house")


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "missing key default"),
        ("[default]\nv_mx = 1", "2: unknown key default.v_mx; did you mean 'v_max'?"),
        ("[default]\nv_max = nan", "2: default.v_max = nan"),
        ('[default]\nv_max = "slow"', "expected a number"),
        ("[default]\narea = [[[0,0],[1,1],[1,0],[0,1]]]", "default.area[0]: expected sides"),
        ("[default]\narea = [[[0,0],[1,nan],[1,0]]]", "expected two numbers, m"),
        ('[default]\nrooms = ["Z"]', "no room 'Z'; known: A, B, C, D, E, corridor"),
        ('[default]\nkeep_out_rooms = ["coridor"]', "did you mean 'corridor'?"),
        ('[default]\nforbidden = ["got"]', "no tool 'got'; did you mean 'goto'?"),
        ('[default]\nforbidden = ["stop"]', "a stop is never limited"),
        ('[default]\nhours = ["8-18"]', "expected a begin and an end, as 08:00-18:00"),
        ('[default]\ndays = ["monday"]', "did you mean 'mon'?"),
        ("[default]\n[clients.a]\nv_max = 0", "3: clients.a.v_max = 0"),
        ("[default", "not TOML"),
    ],
)
def test_what_is_wrong_is_named_with_its_place_and_what_would_be_right(
    text: str, named: str, tmp_path: Path
) -> None:
    path = tmp_path / "policy.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as error:
        load(path, WORLD)
    assert named in str(error.value)
    assert str(error.value).startswith(str(path))


@pytest.mark.parametrize("key", ['rooms = ["A"]', "people_m = 1.0"])
def test_what_needs_a_map_is_refused_without_one(key: str) -> None:
    with pytest.raises(ConfigError, match="no map is known"):
        read(f"[default]\n{key}")


@pytest.mark.parametrize("text", ["[default]\nv_mx = 1", "", "[default]\nv_max = nan"])
def test_nothing_but_a_stop_is_allowed_with_a_policy_that_is_wrong(
    text: str, tmp_path: Path
) -> None:
    (path := tmp_path / "policy.toml").write_text(text)
    counter = Counter(policy=str(path))
    for tool in ("where", "goto", "mission", "cancel", "resume"):
        arguments = {"goto": {"x": 1, "y": 1}, "mission": {"name": "x"}, "cancel": {"number": "1"}}
        assert str(path) in counter.refusal(tool, **arguments.get(tool, {}))
    assert not counter.queries
    assert counter.request("stop").refusal == ""  # type: ignore[union-attr]
    assert counter.stops


def test_corners_are_limited_in_total() -> None:
    corners = [[cos(n * pi / 128), sin(n * pi / 128)] for n in range(256)]
    round_ = json.dumps(corners)
    read(f"[default]\narea = [{round_}, {round_}]")
    with pytest.raises(ConfigError, match=r"2: default\.area: expected at most 512 corners"):
        read(f"[default]\narea = [{round_}, {round_}]\nkeep_out = [[[0,0],[1,0],[1,1]]]")


def test_a_policy_that_is_not_there_allows_nothing() -> None:
    assert "/nowhere.toml" in Counter(policy="/nowhere.toml").refusal("where")


def test_an_empty_list_lifts_a_rule_of_the_default_section() -> None:
    lifts = "forbidden = []\napproval = []\napproval_rooms = []"
    rules = 'forbidden = ["goto"]\napproval = ["goto"]\napproval_rooms = ["C"]'
    mine = read(f"[default]\n{rules}\n[clients.mine]\n{lifts}", world=WORLD).clients["mine"]
    assert not mine.forbids("goto")
    assert not mine.section.approval
    assert not mine.section.approval_rooms


def test_a_clients_section_has_the_default_where_it_says_nothing() -> None:
    policy = read('[default]\nv_max = 0.2\nforbidden = ["mission"]\n[clients.mine]\nv_max = 0.5')
    assert policy.of("mine").section.v_max == 0.5
    assert policy.of("mine").forbids("mission")
    assert policy.of("other").section.v_max == 0.2
    assert policy.of("Mine") is policy.default, "names are compared exactly"


@given(st.integers(0, 23), st.integers(0, 59), st.integers(0, 23), st.integers(0, 59))
def test_hours_may_go_over_midnight(begin: int, minute: int, end: int, now: int) -> None:
    if (begin, minute) == (end, now):
        return
    span = f"{begin:02}:{minute:02}-{end:02}:{now:02}"
    rules = read(f'[default]\nhours = ["{span}"]').default
    open_ = {
        h * 60 + m
        for h in range(24)
        for m in range(60)
        if not rules.closed(datetime(2026, 11, 30, h, m))
    }
    length = ((end * 60 + now) - (begin * 60 + minute)) % 1440
    assert open_ == {(begin * 60 + minute + i) % 1440 for i in range(length)}


def test_days_are_those_of_the_week() -> None:
    rules = read('[default]\ndays = ["mon", "tue"]').default
    assert not rules.closed(datetime(2026, 11, 30))
    assert "sun" in rules.closed(datetime(2026, 11, 29))


@pytest.mark.parametrize(
    ("limit", "refused"),
    [
        ('hours = ["08:00-18:00"]', True),
        ('days = ["mon"]', True),
        ('approval_rooms = ["C"]', True),
        ("v_max = 0.3", True),
        ("goals_an_hour = 3", False),
    ],
)
def test_tasks_whose_drives_cannot_be_limited_are_refused_by_each_limit(
    limit: str, refused: bool
) -> None:
    rules = read(f"[default]\n{limit}", world=WORLD).default
    assert bool(rules.unbound(["explore"])) == refused
    assert bool(rules.unbound(["dock"])) == refused
    assert not rules.unbound(["move"])


@pytest.mark.parametrize("name", names("policies"))
def test_the_shipped_policies_are_right(name: str) -> None:
    load(find("policies", name), WORLD)
