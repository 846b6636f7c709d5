"""Faults as data: drawn from a seed, written as JSON, shrunk to what matters."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.core import discovery
from armadico.core.config_errors import ConfigError
from armadico.core.discovery import installed
from armadico_tools.faults.fault_types import KINDS
from armadico_tools.faults.plan import (
    BEGIN_S,
    CALM_END_S,
    Case,
    Fault,
    Variation,
    draw,
    loads,
    swarm,
)
from armadico_tools.faults.shrink import AFTER_S, NOISE, Shrinker
from armadico_tools.faults.variants import case_of


@given(st.integers(0, 2**32), st.floats(10.0, 300.0))
def test_a_seed_draws_faults_within_the_run_that_survive_json(seed: int, lasts: float) -> None:
    case = case_of(seed, lasts)
    assert loads(case.dumps()) == case
    for fault in case.faults:
        assert BEGIN_S <= fault.at <= fault.until <= lasts
        assert fault.targets
        assert {*fault.targets, *fault.to} <= {*installed(discovery.AGENTS)}
    assert [fault.at for fault in case.faults] == sorted(fault.at for fault in case.faults)


@given(st.integers(0, 1000), st.sampled_from(sorted(KINDS)))
def test_only_the_selected_kinds(seed: int, kind: str) -> None:
    assert {fault.kind for fault in draw(Random(seed), 200.0, [kind])} == {kind}


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("{", "not a case"),
        ('{"seed": 1}', "scenario"),
        ('{"seed": 1, "scenario": "sc1", "lasts": -1, "faults": []}', "lasts"),
        ('{"seed":1,"scenario":"sc1","lasts":9,"faults":[["flod",1,1,["goto"]]]}', "flod"),
        ('{"seed":1,"scenario":"sc1","lasts":9,"faults":[["hang",1,1,["gogo"]]]}', "gogo"),
    ],
)
def test_what_is_no_case_is_refused_with_the_reason(text: str, why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        loads(text)


# Shrinking ----------------------------------------------------------------------------------------


@given(
    st.lists(st.floats(1.0, 90.0), min_size=1, max_size=12, unique=True),
    st.data(),
)
def test_it_is_shrunk_to_the_faults_that_it_takes(times: list[float], data: st.DataObject) -> None:
    """Something breaks 0.5 s after the last of some faults, if all of them are there."""
    faults = tuple(Fault("hang", at, 2.0, ("goto",)) for at in sorted(times))
    culprits = set(data.draw(st.lists(st.sampled_from(faults), min_size=1, max_size=3)))
    at = max(fault.at for fault in culprits) + 0.5
    starts = {fault.at for fault in culprits}

    def broken(case: Case) -> float | None:
        return at if starts <= {f.at for f in case.faults if f.lasts >= 0.5} else None

    shrinker = Shrinker(broken, 2000)
    small = shrinker.shrink(Case(1, "sc1", 100.0, faults))
    assert {fault.at for fault in small.faults} == starts
    assert {fault.lasts for fault in small.faults} == {0.5}
    assert small.lasts == pytest.approx(at + AFTER_S, abs=0.001)


def test_what_breaks_without_a_fault_is_shrunk_to_none() -> None:
    shrinker = Shrinker(lambda case: 5.0)
    faults = tuple(Fault("hang", float(at), 1.0, ("goto",)) for at in range(1, 9))
    assert shrinker.shrink(Case(1, "sc1", 60.0, faults)) == Case(1, "sc1", 5.2, ())


def test_what_breaks_nothing_cannot_be_shrunk() -> None:
    with pytest.raises(ValueError, match="seed 7 breaks nothing"):
        Shrinker(lambda case: None).shrink(Case(7, "sc1", 60.0, ()))


def test_it_gives_up_after_so_many_runs() -> None:
    faults = tuple(Fault("hang", float(at), 1.0, ("goto",)) for at in range(1, 60))
    shrinker = Shrinker(lambda case: 59.5 if len(case.faults) > 50 else None, 10)
    assert len(shrinker.shrink(Case(1, "sc1", 60.0, faults)).faults) > 50
    assert shrinker.tries == 10


def test_a_case_that_breaks_with_other_noise_only_is_small_all_the_same() -> None:
    """Whatever is left out changes the noise: without it the case breaks with another seed."""
    faults = tuple(Fault("hang", float(at), 1.0, ("goto",)) for at in range(1, 9))

    def broken(case: Case) -> float | None:
        chaos = (case.seed // NOISE + len(case.faults)) % 3 == len(faults) % 3
        return 9.0 if chaos and faults[4] in case.faults else None

    steps: list[int] = []
    shrinker = Shrinker(broken, 200, lambda: steps.append(1))
    small = shrinker.shrink(Case(7, "sc1", 60.0, faults))
    assert [fault.at for fault in small.faults] == [faults[4].at]
    assert broken(small) is not None
    assert len(steps) == shrinker.tries <= 200


# Swarms -------------------------------------------------------------------------------------------


def test_each_seed_has_some_of_the_kinds() -> None:
    taking = [swarm(Random(seed)).kinds for seed in range(200)]
    assert {kind for kinds in taking for kind in kinds} == {*KINDS}
    shares = [sum(kind in kinds for kinds in taking) / len(taking) for kind in KINDS]
    assert all(0.35 < share < 0.65 for share in shares)


def test_some_long_runs_are_calm_at_their_end_so_that_they_must_arrive() -> None:
    calm = [
        all(fault.until <= 150.0 - CALM_END_S for fault in case_of(seed, 150.0).faults)
        for seed in range(100)
    ]
    assert 10 <= sum(calm) <= 35


def test_networks_differ_and_a_case_has_the_difference() -> None:
    drawn = {case_of(seed, 30.0).variation for seed in range(50)}
    assert Variation() in drawn
    assert len(drawn) >= 3
    plain = Case(1, "sc1", 9.0, ())
    assert "variation" not in plain.dumps()
    slow = Case(1, "sc1", 9.0, (), Variation(0.005))
    assert loads(slow.dumps()) == slow
