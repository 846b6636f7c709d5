"""Options declared as the fields of a frozen dataclass, and what they are parsed into."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import FrozenInstanceError, dataclass
from math import pi, radians
from pathlib import Path

import pytest

from armadico.cli.options import Mesh
from armadico.cli.parsing import (
    POSE,
    BadValueError,
    Command,
    UsageError,
    argument,
    at_least,
    flag,
    group,
    option,
    several,
)


def even(text: str) -> int:
    if int(text) % 2:
        raise BadValueError(f"{text} is odd")
    return int(text)


@dataclass(frozen=True, kw_only=True)
class Base:
    plain: str = "no option"
    jobs: int | None = None
    file: Path = argument("a file", metavar="FILE")


@dataclass(frozen=True, kw_only=True)
class Options(Base):
    jobs: int | None = option("processes", must=at_least(1))
    quick: bool = flag("at once", either="pace")
    slow: bool = flag("later", either="pace")
    start: tuple[float, float, float] | None = option("where", must=POSE)
    heading: float | None = option("in degrees", must=at_least(0), turned=radians)
    leave: Sequence[str] = several("what is left out", "--without")
    also: tuple[tuple[str, str], ...] = several("pairs")
    kinds: tuple[str, ...] | None = option("kinds", nargs="*", choices=("a", "b"))
    count: int = option("how many", "-n", default=2, read=even)
    mesh: Mesh = group(Mesh, "the mesh")


command = Command("armadico test", Options, lambda _: 0, "Test.", "  armadico test x\n")


def test_what_is_not_given_has_its_default() -> None:
    found = command.parse(["x.toml"])
    assert found == Options(file=Path("x.toml"), mesh=found.mesh)
    assert (found.plain, found.leave, found.kinds, found.count) == ("no option", (), None, 2)
    with pytest.raises(FrozenInstanceError):
        found.jobs = 3  # type: ignore[misc]


def test_values_are_as_they_are_annotated() -> None:
    words = "x --jobs 3 --quick --start 1 -2.5 -1e1 --without a --without b --kinds a b -n 4"
    more = "--also r 1 --also s 2 --heading 180"
    found = command.parse([*words.split(), *more.split()])
    assert (found.jobs, found.quick, found.slow) == (3, True, False)
    assert found.start == (1.0, -2.5, -10.0)
    assert found.heading == pi
    assert found.leave == ("a", "b")
    assert found.also == (("r", "1"), ("s", "2"))
    assert (found.kinds, found.count) == (("a", "b"), 4)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--jobs", "0"], "--jobs 0: "),
        (["--start", "1", "nan", "0"], "--start 1 nan 0: "),
    ],
)
def test_a_value_that_must_not_be_is_named(words: list[str], says: str) -> None:
    with pytest.raises(UsageError, match=says):
        command.parse(["x", *words])


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--quick", "--slow"], "--slow: not allowed with argument --quick"),
        (["-n", "3"], "3 is odd"),
        (["--kinds", "c"], "invalid choice: 'c'"),
        (["--qu"], "--qu: no such option; did you mean --quick?"),
        (["--star", "1", "-2", "0"], "--star: no such option; did you mean --start?"),
        (["--job=3"], "--job: no such option; did you mean --jobs?"),
        (["-x"], "-x: no such option; see armadico test --help"),
        (["--zz"], "--zz: no such option; see armadico test --help"),  # only the dashes are alike
        (["more"], "unrecognized arguments: more"),
    ],
)
def test_what_cannot_be_read_is_named_in_one_line(
    words: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        command.parse(["x", *words])
    assert end.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("armadico test: error: ")
    assert says in line


def test_a_value_with_a_dash_is_no_option() -> None:
    found = command.parse(["--without=-a", "--start", "-1", "-.5", "-1e1", "--", "-x"])
    assert found.leave == ("-a",)
    assert found.start == (-1.0, -0.5, -10.0)
    assert found.file == Path("-x")
