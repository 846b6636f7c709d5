"""The demo of several hosts, as containers of Docker Compose: `make demo`.

The host whose goto drives is killed in the middle of a run, another host's takes over, and the
killed host is started again. A host is a service of deploy/compose.yaml. All commands run inside:
the containers' network may be unreachable from this machine.
"""

from __future__ import annotations

import json
import os
import secrets
import shutil
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol, Self

from armadico.cli.options import FailedError, end_as_by_ctrl_c, guarded
from armadico.cli.parsing import Command, argument
from armadico.config.hosts import load_hosts
from armadico.config.scenarios import load_scenario
from armadico.core.judgement import Judgement, all_of, no, unknown, yes
from armadico.launch.programs import end
from armadico_tools.testbed import TABLE

FILE: Final = Path(__file__).resolve().parents[3] / "deploy" / "compose.yaml"
"""The description of the containers; `COMPOSE_FILE` in the environment names others."""

IMAGE: Final = "armadico"
"""The name of all hosts' image in the compose file."""

DESK: Final = "desk"
"""The operator's computer, in no host table: it sends the goal, records, and serves the page."""

PAGE_PORT: Final = 8090
"""The page's port in the desk's container."""

DRIVER: Final = "goto"
"""The agent whose host is killed while it drives."""

AWAY_S: Final = 8.0
"""How long the lost host stays away: longer than the monitor waits for it, 3 s."""

AT_ONCE_S: Final = 1.0
"""Longest time without an obeyed command for a takeover that is one."""

LOOKS: Final = 20
"""How often the desk looks for the agents of the host that came back; each look takes a second."""

START_S: Final = 90
"""Time limit until all containers are healthy."""

INSTEAD: Final = "Without an engine, use `make run`, which needs this machine only."

EXAMPLES: Final = """\
  make demo
  make demo SCENARIO=house
  PAGE_PORT=8091 make demo    if another program uses port 8090, the page's
  COMPOSE_FILE=deploy/compose.yaml:mine.yaml make demo    with your own override file
"""


class Hosts(Protocol):
    """Hosts of the demo's host table and the operator's desk, real or not."""

    names: tuple[str, ...]
    recording: str
    """The path of the run's recording on the desk."""

    def start(self, host: str) -> None:
        """Run a host's part of the society; may return before it is ready."""

    def stop(self, host: str) -> None:
        """Stop a host at once."""

    def popen(self, host: str, argv: Sequence[str], **options: object) -> subprocess.Popen[str]:
        """Run a command on a host or on `DESK`; its output is piped, as text."""


class Lost(NamedTuple):
    """The host that was killed, and the instances that ran there."""

    host: str
    instances: frozenset[str]


def demo(hosts: Hosts, scenario: str, say: Callable[[str], None]) -> Judgement:
    """Drive, kill the host whose goto drives, start it again, and print `armadico why`.

    Returns whether another host took over at once, the goal was reached, and the host came back.
    """
    for host in hosts.names:
        hosts.start(host)
    robots = load_hosts(TABLE).robots_host
    words = ("run", scenario, "--attach", "--no-plot", "--record", hosts.recording)
    run = hosts.popen(DESK, _armadico(*words), stderr=subprocess.STDOUT)
    assert run.stdout is not None, "it is a pipe"
    lost: Lost | None = None
    back_at: float | None = None
    try:
        for line in run.stdout:
            say(line.rstrip())
            if lost is None and f", {DRIVER} drives" in line:
                lost = driving(_asked(hosts, "ps", "--json")[1], but=robots)
                if lost is not None:
                    say(f"{lost.host}, whose {DRIVER} drives, is killed")
                    hosts.stop(lost.host)
                    back_at = time.monotonic() + AWAY_S
            elif lost is not None and back_at is not None and time.monotonic() > back_at:
                say(f"{lost.host} is started again")
                hosts.start(lost.host)
                back_at = None
        code = run.wait()
    finally:
        end(run)
    if lost is None:
        return unknown(f"no host was killed: {DRIVER} did not drive", "drive a longer scenario")
    back = back_at is None and _is_back(hosts, lost.host, say)
    told, story = _asked(hosts, "why", hosts.recording)
    for line in story.splitlines():
        say(line)
    found = _asked(hosts, "why", hosts.recording, "--json")[1] if told == 0 else ""
    return judged(lost, code, found, back=back)


def driving(ps: str, *, but: str | None) -> Lost | None:
    """The host whose goto holds the wheels, by `armadico ps --json`; None if there is none.

    The host `but` of the robot agent is never the one to kill: nothing can replace it.
    """
    agents = [each for each in _read(ps).get("agents", ()) if each.get("answering")]
    for agent in agents:
        host = agent["host"]
        if agent["name"] == DRIVER and "wheels" in agent["holds"] and host != but:
            return Lost(host, frozenset(a["instance"] for a in agents if a["host"] == host))
    return None


def judged(lost: Lost, code: int, why: str, *, back: bool) -> Judgement:
    """Whether it was a failover.

    Args:
        lost: The host that was killed.
        code: The exit code of the run.
        why: What `armadico why --json` prints of its recording; empty: it failed.
        back: Whether the host's agents were alive again at the end.
    """
    run = {0: yes(), 3: unknown("the run's own result is unknown (exit code 3)")}
    came = yes() if back else no(f"{lost.host} is not back, or one of its agents runs nowhere")
    return all_of(
        [
            _taken_over(lost, why),
            run.get(code, no(f"the run did not pass (exit code {code})")),
            came,
        ]
    )


def _taken_over(lost: Lost, why: str) -> Judgement:
    """Whether another host's agent drove soon after the last command of the lost host's agents."""
    drives = _read(why).get("drives", ())
    mine = [n for n, each in enumerate(drives) if each["instance"] in lost.instances]
    if not mine:
        return unknown(
            f"the recording does not show who drove when {lost.host} was lost",
            "see the lines of `armadico why`",
        )
    after = drives[mine[-1] + 1 :]
    if not after:
        return no(f"no agent drove after {lost.host} was lost")
    gap = after[0]["begun"] - drives[mine[-1]]["ended"]
    place = f"{after[0]['instance'].rpartition('-')[0]} on {after[0]['host'] or 'an unknown host'}"
    took = f"{gap:.2f} s after the last obeyed command of {lost.host}, {place} drove"
    return yes(took) if gap <= AT_ONCE_S else no(f"{took}: not at once, {AT_ONCE_S:g} s")


def _is_back(hosts: Hosts, host: str, say: Callable[[str], None]) -> bool:
    """Whether a host soon runs its agents again; says so.

    An agent of which one is enough stays where the monitor had it started meanwhile.
    """
    wanted = {*load_hosts(TABLE).hosts[host].agents}
    for _ in range(LOOKS):
        agents = _read(_asked(hosts, "ps", "--json")[1]).get("agents", ())
        places = [(each["name"], each["host"]) for each in agents if each.get("answering")]
        here = wanted & {name for name, where in places if where == host}
        moved = [f"{name} stays on {on}" for name, on in places if name in wanted - here]
        if DRIVER in here and here | {name for name, _ in places} >= wanted:
            say("; ".join([f"{host} is back", *moved]))
            return True
    return False


def _asked(hosts: Hosts, *words: str) -> tuple[int, str]:
    """The exit code and the output of a command on the desk."""
    process = hosts.popen(DESK, _armadico(*words), stderr=subprocess.DEVNULL)
    try:
        out, _ = process.communicate()
    finally:
        end(process)
    return process.returncode, out


def _armadico(command: str, *words: str) -> list[str]:
    """The words of a command; one that reads a recording needs no host table."""
    return ["armadico", command, *words, *(() if command == "why" else ("--hosts", TABLE))]


def _read(text: str) -> dict[str, Any]:
    """A JSON object; empty if it is none."""
    with suppress(ValueError):
        found = json.loads(text)
        if isinstance(found, dict):
            return found
    return {}


class ComposeHosts:
    """The services of a compose file, as a context manager that removes them in the end."""

    recording = "/tmp/demo.mcap"

    def __init__(self, scenario: str, say: Callable[[str], None]) -> None:
        """Prepare.

        Args:
            scenario: The scenario of all hosts.
            say: Called with a line for each step and its duration.
        """
        self.names: tuple[str, ...] = tuple(load_hosts(TABLE).hosts)
        self._say = say
        self._token = secrets.token_urlsafe(24)
        self._environment = {
            "COMPOSE_FILE": str(FILE),
            **os.environ,
            "SCENARIO": scenario,
            "WORLD": load_scenario(scenario).world,
            "PAGE_TOKEN": self._token,
        }

    def __enter__(self) -> Self:
        """Build the image and start every host. Raises FailedError."""
        self.down()  # the remains of a demo that was killed
        try:
            began = time.monotonic()
            self._say("building the image")
            self._do("build")
            self._say(f"image built, {_size()}, {time.monotonic() - began:.1f} s")
            began = time.monotonic()
            self._do("up", "--detach", "--wait", "--wait-timeout", str(START_S))
            self._say(f"all containers are healthy, {time.monotonic() - began:.1f} s")
            self._say(self._page())
        except BaseException:
            self.down()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self._say("removing the containers")
        self.down()

    def start(self, host: str) -> None:
        """Start a host's container. No effect if it runs."""
        self._do("up", "--detach", "--no-deps", "--no-build", host)

    def stop(self, host: str) -> None:
        """Kill everything in a host's container, like a power failure."""
        self._do("kill", host)

    def popen(self, host: str, argv: Sequence[str], **options: Any) -> subprocess.Popen[str]:
        """Start a command in a host's container; its output is piped.

        Ending the result ends this side only; the command ends with the container.
        """
        return _Client(
            ["docker", "compose", "exec", "--no-TTY", host, *argv],
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
            start_new_session=True,  # Ctrl-C reaches the demo, which takes the containers down
            **options,
        )

    def down(self) -> None:
        """Remove the containers and their network; a second Ctrl-C does not interrupt it."""
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            self._do("down", "--timeout", "1", "--remove-orphans")
        finally:
            signal.signal(signal.SIGINT, before)

    def _page(self) -> str:
        """The link to the control page, from the port that Docker has published."""
        address = self._do("port", DESK, str(PAGE_PORT)).strip()
        link = f"page: http://{address}/#token={self._token}"
        try:
            urllib.request.urlopen(f"http://{address}/", timeout=5.0).close()
        except urllib.error.HTTPError:
            return link  # it answers
        except OSError as error:
            return f"{link} (on the engine's machine; not reachable from this one: {error})"
        return link

    def _do(self, *words: str) -> str:
        """Run a command of Compose; returns its output. Raises FailedError with its last lines."""
        command = ["docker", "compose", *words]
        done = subprocess.run(
            command,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
            check=False,
        )
        if done.returncode:
            output = "\n".join(f"    {line}" for line in done.stdout.strip().splitlines()[-15:])
            raise FailedError(f"{' '.join(command)} ended with {done.returncode}:\n{output}")
        return done.stdout


class _Client(subprocess.Popen[str]):
    """This side of a command in a container: `docker` and its plug-in."""

    def terminate(self) -> None:
        """Kill it: a client that is terminated would print so."""
        self.kill()

    def kill(self) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)


def _size() -> str:
    """The size of the image, as Docker counts."""
    done = subprocess.run(
        ["docker", "image", "inspect", "--format", "{{.Size}}", IMAGE],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    found = done.stdout.strip()
    return f"{int(found) / 1e6:.0f} MB" if found.isdecimal() else "of unknown size"


def lacking() -> str | None:
    """What this machine lacks for the demo, in a sentence; None if nothing."""
    if shutil.which("docker") is None:
        return "the command docker is missing (Docker Engine, or Docker Desktop)"
    if _failure("docker", "compose", "version") is not None:
        packages = "Docker's repository: docker-compose-plugin; Debian 13: docker-compose"
        return f"docker has no Compose v2 ({packages}; Ubuntu: docker-compose-v2)"
    trouble = _failure("docker", "version")
    if trouble is not None:
        return f"no engine answers: {trouble}"
    if not FILE.exists() and "COMPOSE_FILE" not in os.environ:
        return f"{FILE} is missing: the demo is run from a checkout"
    return None


def _failure(*command: str) -> str | None:
    """The last line of output of a command that failed; None if it succeeded."""
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    lines = (done.stderr or done.stdout).strip().splitlines()
    return (lines[-1] if lines else "no reason given") if done.returncode else None


@dataclass(frozen=True, kw_only=True)
class Words:
    scenario: str = argument(
        "drive SCENARIO (default: sc4)", nargs="?", default="sc4", metavar="SCENARIO"
    )


def run(args: Words) -> int:
    """Run the demo; returns 0 for a failover, 1 for none, 3 if it is unknown."""
    trouble = lacking()
    if trouble is not None:
        raise FailedError(f"{trouble}\n{INSTEAD}")
    end_as_by_ctrl_c()
    say = partial(print, flush=True)
    with ComposeHosts(args.scenario, say) as hosts:
        judgement = demo(hosts, args.scenario, say)
    say(f"failover: {judgement}" + (f"; {judgement.cure}" if judgement.cure else ""))
    return judgement.exit_code


command = Command(
    "make demo",
    Words,
    run,
    "Run three hosts as containers; kill the one whose goto drives, see another take over, and"
    " start the lost one again. Exit code 0: it was a failover, 1: it was not, 3: unknown.",
    EXAMPLES,
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; errors are one line."""
    words = list(sys.argv[1:] if argv is None else argv)
    return guarded("make demo", lambda: command(words))


if __name__ == "__main__":
    sys.exit(main())
