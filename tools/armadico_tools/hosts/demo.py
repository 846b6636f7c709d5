"""The demo of several hosts: one is lost in the middle of a run, and comes back.

Hosts are whatever can be started, stopped and run commands on: containers, and in a test network
namespaces. What is printed was received by a watcher on one of them.
"""

from __future__ import annotations

import queue
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Final, Protocol

from armadico.cli.options import FailedError
from armadico.cli.remote_observer import read
from armadico.config.hosts import load_hosts
from armadico.config.scenarios import load_scenario
from armadico.launch.processes import end
from armadico_tools.hosts.timeline import Story
from armadico_tools.testbed import TABLE

LOST: Final = "lab2"
"""The host that is lost: that of the behaviours."""

BESIDE: Final = ("lab1", "avoid")
"""Where a second avoid stands by."""

SEAT: Final = "lab3"
"""The host from which the society is watched and sent on its mission."""

WATCHES: Final = ("python", "-P", "-m", "armadico.cli.remote_observer")
DRIVES: Final = ("armadico", "run")
"""What is started on the seat, which has the product and nothing else."""

START_S: Final = 60.0
LATEST: Final = 0.6
"""Lost at this share of the way at the latest, whoever would drive on."""

EARLIEST: Final = 0.1
AWAY_S: Final = 4.0
"""How long the host stays away."""

END_S: Final = 600.0
"""Longer than any run takes; `armadico run` has a limit of its own."""


class Hosts(Protocol):
    """Machines, real or not, of the demo's host table."""

    names: tuple[str, ...]

    def start(self, host: str) -> None:
        """Have a host run its share of the society, `BESIDE` included; it may return before."""

    def stop(self, host: str) -> None:
        """Take a host away at once."""

    def popen(self, host: str, argv: Sequence[str]) -> subprocess.Popen[str]:
        """Run a command on a host, `armadico ...` or `python ...`; its output is piped, as text."""


def demo(hosts: Hosts, scenario: str, say: Callable[[str], None]) -> int:
    """Run it; returns the run's exit code. Raises FailedError if the society does not come up."""
    for host in hosts.names:
        hosts.start(host)
    watcher = _Watcher(hosts)
    try:
        return _play(hosts, watcher, scenario, say)
    finally:
        watcher.close()


def _play(hosts: Hosts, watcher: _Watcher, scenario: str, say: Callable[[str], None]) -> int:
    story = watcher.story
    began = time.monotonic()
    wanted = _wanted(scenario)
    watcher.until(lambda: not story.lacks(wanted), START_S)
    if lacks := story.lacks(wanted):
        raise FailedError(f"not alive after {START_S:.0f} s: {', '.join(lacks)}")
    say(f"all agents are alive, {time.monotonic() - began:.1f} s after the watcher")
    run = _Command(hosts, *DRIVES, scenario, "--attach", "--no-plot")
    try:
        watcher.until(lambda: run.ended() or _moment(story), END_S)
        if run.ended():
            say(f"the run ended before {LOST} was lost")
        else:
            _lose(hosts, watcher, set(wanted[LOST]), say)
        watcher.until(run.ended, END_S)
    finally:
        code = run.close()
    say(run.output())
    return code


def _wanted(scenario: str) -> dict[str, tuple[str, ...]]:
    """Who belongs on each host: those of the table that take part, and who stands by."""
    taking = ("robot", *load_scenario(scenario).agents)
    wanted = {
        name: tuple(agent for agent in host.agents if agent in taking)
        for name, host in load_hosts(TABLE).hosts.items()
    }
    host, name = BESIDE
    return wanted | {host: (*wanted[host], name)}


def _moment(story: Story) -> bool:
    """Whether to lose the host now: it drives, and an agent elsewhere would drive on."""
    drives = story.host(story.driver) == LOST and story.done() >= EARLIEST
    return drives and (bool(story.standing_by(LOST)) or story.done() >= LATEST)


def _lose(hosts: Hosts, watcher: _Watcher, agents: set[str], say: Callable[[str], None]) -> None:
    """Lose the host, print what comes of it, and have it back."""
    story = watcher.story
    standing_by = story.standing_by(LOST).items()
    would = ", ".join(f"{story.name(who)} ({utility:.2f})" for who, utility in standing_by)
    say(f"{LOST} is stopped: {story.name(story.driver)} drives, {story.speed:.2f} m/s")
    say(f"  who elsewhere would drive: {would or 'no agent has a reason to'}")
    hosts.stop(LOST)
    back_at = time.monotonic() + AWAY_S
    watcher.until(lambda: not story.on(LOST), AWAY_S)
    found = story.last_command(LOST)
    assert found is not None, "it drove"
    at, last = found
    gone = last.ballot.instance
    left = max(0.5, back_at - AWAY_S + 1.5 - time.monotonic())
    watcher.until(lambda: story.next_obeyed(at, (gone,)), left)
    taken = story.next_obeyed(at, (gone,))
    if taken is not None:
        then, by = taken
        say(
            f"  {story.name(by.ballot.instance)} took over: obeyed {1e3 * (then - at):.0f} ms,"
            f" {by.cycle.number - last.cycle.number} cycles, after the last command of"
            f" {story.name(gone)}"
        )
    else:
        say("  no agent took over: the robot stops by itself")
    watcher.until(lambda: False, back_at - time.monotonic())
    say(f"  {AWAY_S:.0f} s later {story.name(story.driver)} drives")
    _return(hosts, watcher, agents, say)


def _return(hosts: Hosts, watcher: _Watcher, agents: set[str], say: Callable[[str], None]) -> None:
    """Start it again, and print when its agents are back and when one of them drives."""
    story = watcher.story
    say(f"{LOST} is started again")
    began = story.now
    hosts.start(LOST)
    watcher.until(lambda: agents <= story.on(LOST).keys(), START_S)
    if lacks := agents - story.on(LOST).keys():
        say(f"  not back after {START_S:.0f} s: {', '.join(sorted(lacks))}")
        return
    took = max(story.on(LOST)[name] for name in agents) - began
    say(f"  {', '.join(sorted(agents))} are back {took:.1f} s later")
    watcher.until(lambda: story.host(story.driver) == LOST, START_S)
    if story.host(story.driver) == LOST:
        say(f"  {story.name(story.driver)} drives, {story.now - began:.1f} s after the start")


class _Command:
    """A command on the seat, and what it prints, line by line as it comes."""

    def __init__(self, hosts: Hosts, *words: str) -> None:
        self.lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.process = hosts.popen(SEAT, (*words, "--host", SEAT, "--hosts", TABLE))
        self._reader = threading.Thread(target=self._read, name=words[0], daemon=True)
        self._reader.start()

    def ended(self) -> bool:
        """Whether it is over."""
        return self.process.poll() is not None

    def close(self) -> int:
        """End it, if it has not ended; its exit code. What it did elsewhere ends with its host."""
        if self.ended():
            self._reader.join()
        end(self.process)
        return self.process.returncode

    def output(self) -> str:
        """What it printed, but for what was taken out of `lines`."""
        return "".join(self.lines.get() for _ in range(self.lines.qsize())).rstrip()

    def _read(self) -> None:
        assert self.process.stdout is not None, "it is piped"
        with suppress(ValueError):  # closed meanwhile
            for line in self.process.stdout:
                self.lines.put(line)


class _Watcher(_Command):
    """The observer's process, and the story so far."""

    def __init__(self, hosts: Hosts) -> None:
        self.story = Story()
        super().__init__(hosts, *WATCHES)

    def until(self, condition: Callable[[], object], within: float) -> None:
        """Take what comes until a condition is true, or time is up (s). Raises FailedError."""
        deadline = time.monotonic() + within
        while not condition() and (left := deadline - time.monotonic()) > 0:
            with suppress(queue.Empty):
                found = read(self.lines.get(timeout=min(left, 0.2)))
                if found is not None:
                    self.story.hear(found)
            if self.process.poll() not in (None, 0) and self.lines.empty():
                raise FailedError(f"the watcher on {SEAT} ended: {self.process.returncode}")
