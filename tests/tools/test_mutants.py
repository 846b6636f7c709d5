"""Mutants: what is left out, how a change is named, and that what is explained is still there."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest

from armadico_tools import mutants
from armadico_tools.mutants import (
    LEFT_OUT,
    ROOT,
    TESTS,
    Mutant,
    Outcome,
    name_of,
    outcomes,
    path_of,
    summary,
)
from armadico_tools.mutants_explained import EXPLAINED
from armadico_tools.results import Rows

SOURCE = '''"""A module."""


class A:
    x = 1

    @property
    def y(self) -> int:
        """It."""
        assert self.x, "it is"
        z = [
            self.x,
        ]
        return z[0]


def f() -> None:
    print("f")
'''


def test_each_statement_is_left_out_once_but_docstrings_and_asserts() -> None:
    found = dict.fromkeys(text for name, text in mutants._left_out(SOURCE) if name == LEFT_OUT)
    changes = {mutants._difference(SOURCE.splitlines(), text.splitlines()) for text in found}
    assert changes == {
        ("z = [ self.x, ]", "pass", 11),
        ("return z[0]", "pass", 14),
        ('print("f")', "pass", 18),
    }


def test_the_parts_of_a_module_put_back_unchanged_are_the_module() -> None:
    for source in (SOURCE, *(path_of(module).read_text(encoding="utf-8") for module in TESTS)):
        parts = list(mutants._parts(source))
        assert len(parts) > 2
        assert {whole(text) for text, whole in parts} == {source}


def test_what_does_not_compile_or_warns_is_no_mutant() -> None:
    assert mutants._compiles("x = 1")
    assert not mutants._compiles("x = ")
    assert not mutants._compiles("1 is 1")


@pytest.mark.parametrize("module", TESTS)
def test_the_tests_that_are_named_are_there(module: str) -> None:
    assert path_of(module).is_file()
    assert [name for name in TESTS[module] if not (ROOT / "tests" / name).is_file()] == []


def test_a_module_is_changed_where_it_is_imported_from() -> None:
    assert [(module, name_of(module)) for module in ("cycles", "safety")] == [
        ("cycles", "armadico.core.cycles"),
        ("safety", "armadico.core.safety"),
    ]
    for module in TESTS:
        spec = find_spec(name_of(module))
        assert spec is not None
        assert spec.origin is not None
        assert Path(spec.origin).samefile(path_of(module))


def test_what_is_explained_is_still_in_the_code() -> None:
    texts = {
        module: " ".join(
            line.strip() for line in path_of(module).read_text(encoding="utf-8").splitlines()
        )
        for module in TESTS
    }
    assert [key for key in EXPLAINED if key[1] not in texts[key[0].partition(".")[0]]] == []
    named = {name for module in TESTS for name, _, _ in mutants.places(module)}
    assert {key[0] for key in EXPLAINED} <= named
    assert all(EXPLAINED.values())


def test_the_newest_word_counts_and_survivors_that_nobody_explains_are_counted(
    tmp_path: Path,
) -> None:
    made = [Mutant(name, "cycles", 1, "AddNot", "a", "b", "") for name in ("x", "y", "z")]
    rows = Rows(tmp_path / "cycles.csv", Outcome)
    assert outcomes(rows) == {}
    for killed in (False, True):
        rows.add(Outcome("x", "cycles", 1, "AddNot", "a", "b", killed, "", 1))
    known = outcomes(rows)
    assert known == {"x": Outcome("x", "cycles", 1, "AddNot", "a", "b", True, "", 1)}
    assert summary("cycles", made, known) == ("| `cycles` | 3 | 1 | 1 | 100.0% | 0 | 0 |", 0)
    known["y"] = Outcome("y", "cycles", 1, "AddNot", "a", "b", False, "", 1)
    assert summary("cycles", made, known)[1] == 1
