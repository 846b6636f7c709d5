"""Record every scenario live, faults included, replay each, and count what is not equal."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico_tools.command_options import add_json, add_out

if TYPE_CHECKING:
    from armadico.observe.replay import Outcome

FOR_S: Final = 40
"""How long a scenario is driven: s; less if it is done by then."""

TRIALS: Final = 2
"""Faults of one kind in a recording."""

EXAMPLES: Final = """\
  armadico replay-check --list
  sudo .venv/bin/armadico replay-check       all thirty; those with hosts need root
  armadico replay-check sc4 kill-one hang-one@sc3
"""


class Plan(NamedTuple):
    """One recording: what is called, after `armadico`, but for where it is kept."""

    name: str
    words: tuple[str, ...]


def _scenario(name: str, *more: str, called: str = "") -> Plan:
    plot = () if name == "fleet" else ("--no-plot",)
    words = ("run", name, "--for", str(FOR_S), *plot, *more)
    return Plan(called or name, words)


def _fault(kind: str, scenario: str = "", seed: int = 1) -> Plan:
    where = ("--scenario", scenario) if scenario else ()
    words = ("trials", kind, "--trials", str(TRIALS), "--seed", str(seed), *where)
    return Plan(f"{kind}@{scenario}" if scenario else kind, words)


PLANS: Final = (
    *map(_scenario, ("sc1", "sc2", "sc3", "sc4", "rooms-a", "rooms-b", "offices", "house")),
    *map(_scenario, ("floor", "floor-people", "surveillance")),
    _scenario("fleet", "--robots", "2"),  # of ten: a hundred processes
    _scenario("sc4", "--redundant", called="sc4 redundant"),
    _scenario("sc4", "--together", "goto+avoid+gothrough", called="sc4 together"),
    _scenario("sc4", "--exchange", "abrupt", "--sensors", "ideal", called="sc4 abrupt, ideal"),
    _scenario("sc3", "--profile", "amigobot", called="sc3 amigobot"),
    *map(_fault, ("holder-killed", "holder-hung", "nobody-left", "robot-killed")),
    *map(_fault, ("kill-one", "hang-one", "simulator-gone")),
    _fault("kill-one", "sc3", 7),
    _fault("hang-one", "sc3", 7),
    *map(_fault, ("holder-cut-off", "host-lost", "link-down", "partition", "loss-20")),
)
"""Thirty: each scenario that is shipped, some driven otherwise, and each kind of fault."""


class Replayed(NamedTuple):
    """What came of one recording."""

    plan: Plan
    outcomes: list[Outcome]
    seconds: float  # that the replay took
    trouble: str  # why it could not be recorded

    @property
    def equal(self) -> bool:
        """Whether everybody was gone through to the end, and all was equal."""
        whole = all(each.equal and not each.end for each in self.outcomes)
        return bool(self.outcomes) and whole

    @property
    def different(self) -> int:
        """Agents that decide otherwise than they did."""
        return sum(each.difference is not None for each in self.outcomes)


def main(argv: Sequence[str]) -> int:
    """Record and replay; 0 only if all decisions of all agents are equal in all recordings."""
    args = parser().parse_args(argv)
    if args.list:
        for plan in PLANS:
            print(f"{plan.name:<18} armadico {' '.join(plan.words)}")
        return 0
    chosen = [plan for plan in PLANS if not args.names or plan.name in args.names]
    for name in args.names:
        if name not in {plan.name for plan in PLANS}:
            raise UsageError(f"{name}: `armadico replay-check --list` shows what there is")
    options.end_as_by_ctrl_c()
    try:
        args.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FailedError(f"cannot write into {args.out}: {error.strerror}") from None
    found = []
    for number, plan in enumerate(chosen, 1):
        found.append(_one(plan, args.out))
        options.say(f"{number}/{len(chosen)} {_line(found[-1])}")
    if args.json:
        print(json.dumps([_row(each) for each in found], indent=2))
    else:
        print(_summary(found))
    return 0 if all(each.equal for each in found) else options.FAILED


def parser() -> argparse.ArgumentParser:
    """The command's options."""
    made = options.parser(
        "armadico replay-check",
        "Thirty live recordings on Zenoh: every shipped scenario, and every kind of fault on real"
        " processes and links. Each is replayed, and every decision of every agent compared with"
        " what it was.",
        EXAMPLES,
    )
    made.add_argument("names", nargs="*", metavar="NAME", help="only these; see --list")
    made.add_argument("--list", action="store_true", help="the recordings, and how they are made")
    add_out(made, "results/replay-check", "recordings are kept")
    add_json(made)
    return made


def _one(plan: Plan, folder: Path) -> Replayed:
    """Record and replay it, by a process each: as whoever does it by hand, and by the same code."""
    import msgspec  # noqa: PLC0415 - not for --help

    from armadico.observe.replay import Outcome  # noqa: PLC0415

    path = folder / f"{plan.name.replace(' ', '-').replace(',', '')}.mcap"
    for old in folder.glob(f"{path.stem}*.mcap"):
        old.unlink()
    words = [*plan.words, "--record", str(path)]
    if plan.words[0] == "trials":
        words += ["--out", str(folder / "trials")]
    recorded = _called(words)
    if recorded.returncode and not recorded.stdout:  # not driven: its robot was another's, say
        return Replayed(plan, [], 0.0, f"refused: {_last(recorded)}")
    if not path.is_file():
        return Replayed(plan, [], 0.0, f"not recorded: {_last(recorded)}")
    replayed = _called(["replay", str(path), "--json"])
    try:
        found = msgspec.json.decode(replayed.stdout)
    except msgspec.DecodeError:
        return Replayed(plan, [], 0.0, f"not replayed: {_last(replayed)}")
    return Replayed(plan, msgspec.convert(found["agents"], list[Outcome]), found["took_s"], "")


def _called(words: Sequence[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-P", "-m", "armadico", *words],
        capture_output=True,
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
    )


def _last(done: subprocess.CompletedProcess[str]) -> str:
    return (done.stderr.strip().splitlines() or ["it said nothing"])[-1]


def _line(found: Replayed) -> str:
    if found.trouble:
        return f"{found.plan.name}: {found.trouble}"
    outputs = sum(each.outputs for each in found.outcomes)
    longest = max((each.seconds for each in found.outcomes), default=0.0)
    said = f"{found.plan.name}: {len(found.outcomes)} agents, {outputs} outputs, {longest:.0f} s"
    said += f" replayed in {found.seconds:.1f} s, {found.different} differ"
    short = [f"{e.instance}: {e.refusal or e.end}" for e in found.outcomes if e.refusal or e.end]
    return said + "".join(f"; {each}" for each in short)


def _row(found: Replayed) -> dict[str, object]:
    import msgspec  # noqa: PLC0415 - not for --help

    return {
        "name": found.plan.name,
        "command": " ".join(("armadico", *found.plan.words)),
        "equal": found.equal,
        "trouble": found.trouble,
        "took_s": found.seconds,
        "agents": msgspec.to_builtins(found.outcomes),
    }


def _summary(found: Sequence[Replayed]) -> str:
    outcomes = [each for one in found for each in one.outcomes]
    outputs = sum(each.outputs for each in outcomes)
    lives = sum(each.seconds for each in outcomes)
    differ = sum(o.difference is not None for o in outcomes)
    short = sum(bool(o.refusal or o.end) for o in outcomes)
    equal = sum(each.equal for each in found)
    return (
        f"{equal} of {len(found)} recordings equal from beginning to end: {len(outcomes)} agents,"
        f" {lives:.0f} s of their lives, {outputs} outputs; {differ} agents differ, of {short} the"
        f" journal is not whole; {sum(each.seconds for each in found):.1f} s for all replays"
    )
