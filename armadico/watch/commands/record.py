"""Record all messages to an MCAP file, for Foxglove or `armadico export`."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UnknownError
from armadico.cli.parsing import RECORDING, Command, argument, flag, group, more_than, option

if TYPE_CHECKING:
    from armadico.cli.additions import Start
    from armadico.mesh.virtual import VirtualMesh
    from armadico.mesh.zenoh import ZenohMesh
    from armadico.observe.watching import Watcher
    from armadico.watch.recorder import Recording
    from armadico.watch.virtual_recording import Recorded

MEGABYTE: Final = 1_000_000

LOOK_S: Final = 0.05
"""Period of checks whether a recorder has begun."""

LINE_S: Final = 5.0
"""Period of progress lines without a terminal."""

EXAMPLES: Final = """\
  armadico record run.mcap                            until Ctrl-C
  armadico record run.mcap --max-size 100             run.mcap, run-001.mcap, ... of 100 MB each
  armadico record run.mcap --world house              with the map, for ROS 2's tools
  armadico record both.mcap --namespace robot1 --namespace robot2
  armadico record run.mcap --duration 60 && armadico export run.mcap --to csv
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    file: Path = argument("the file to write", metavar="FILE.mcap", must=RECORDING)
    max_size: float | None = option(
        "start another file at this size (default: one file)", metavar="MB", must=more_than(0)
    )
    duration: float | None = option(
        "stop after this time (default: at Ctrl-C)", metavar="S", must=more_than(0)
    )
    force: bool = flag("replace an existing file")
    world: str | None = option(
        "record the walls of this world as the map for ROS 2's tools (default: none)",
        metavar="MAP",
    )
    quiet: bool = flag("print no progress")
    mesh: options.Meshes = group(options.Meshes, "the mesh")


def run(args: Options) -> int:
    meshes = args.mesh.join_each()
    options.need("mcap", "record")
    with ExitStack() as stack:
        for mesh in meshes:
            stack.enter_context(mesh)
        try:
            messages, lost = _record(args, meshes)
        except FileExistsError as error:
            raise FailedError(
                f"{error.filename} exists already; name another file, or use --force"
            ) from None
        except OSError as error:
            raise FailedError(f"cannot write {args.file}: {error.strerror or error}") from None
        missing = [mesh.missing for mesh in meshes if not mesh.wait_joined(0.0)]
    if missing or not messages:
        raise UnknownError("; ".join(missing) or "nothing was received: no agent is alive")
    if lost:
        raise UnknownError(f"{lost} messages were lost: this computer is overloaded")
    return 0


@contextmanager
def recorder(start: Start, path: Path) -> Iterator[None]:
    """A recorder process beside a live run; it records before the first agent starts.

    The map is the scenario's, unless the robot has no map. Raises FailedError.
    """
    from armadico.launch.processes import START_S, Process
    from armadico.launch.programs import end

    options.need("mcap", "record")
    if path.exists():
        raise FailedError(f"{path} exists already; name another file")
    words = ["record", str(path), "--quiet"]
    words += [f"--world={world}"] if (world := _mapped(start)) else []
    words += [word for name in start.namespaces for word in ("--namespace", name)]
    with TemporaryDirectory(prefix="armadico-") as folder:
        log = Path(folder) / "record.log"
        recorder = Process("recorder", [*words, *start.mesh.endpoints().words], log, tied=True)
        try:
            deadline = time.monotonic() + START_S
            while not (path.exists() and path.stat().st_size):
                if recorder.ended() or time.monotonic() >= deadline:
                    raise FailedError(f"nothing is recorded:\n{recorder.last_lines()}")
                time.sleep(LOOK_S)
            yield
        finally:
            end(recorder.popen)
            summary = recorder.last_lines(1).strip()
    _say(summary)


def recorded(start: Start, mesh: VirtualMesh, path: Path) -> Recorded:
    """A context in which a virtual mesh is recorded to a file. Raises FailedError."""
    options.need("mcap", "record")
    from armadico.watch.virtual_recording import Recorded

    try:
        return Recorded(mesh, path, *start.namespaces, world=options.world_of(_mapped(start)))
    except FileExistsError:
        raise FailedError(f"{path} exists already; name another file") from None
    except OSError as error:
        raise FailedError(f"cannot write {path}: {error.strerror or error}") from None


def _mapped(start: Start) -> str | None:
    """The world whose walls are the robot's map, or None."""
    from armadico.config.scenarios import unmapped

    return None if start.scenario is None or unmapped(start.scenario) else start.world


def _record(args: Options, meshes: Sequence[ZenohMesh]) -> tuple[int, int]:
    """Record until it ends; return the numbers of messages, and of those that were lost."""
    from armadico.observe.translators import translators
    from armadico.observe.watching import Watcher
    from armadico.runtime.signals import ending
    from armadico.watch.recorder import Recording, record

    namespaces = [mesh.namespace for mesh in meshes]
    limit = None if args.max_size is None else int(args.max_size * MEGABYTE)
    about = {"version": options.version(), "namespaces": " ".join(namespaces)}
    worlds = dict.fromkeys(namespaces, options.world_of(args.world))
    if args.force:
        args.file.unlink(missing_ok=True)
    recording = Recording(args.file, about, limit, translators(namespaces, worlds))
    watcher = Watcher(meshes)
    begun = time.monotonic()
    signals: list[int] = []
    for number in ending():  # a message that is being written is completed
        signal.signal(number, lambda number, _: signals.append(number))
    try:
        record(
            watcher, recording, _shower(args, watcher, begun), args.duration, lambda: bool(signals)
        )
    finally:
        while (item := watcher.get(0)) is not None:
            recording.add(item)
        recording.close()
    _say(f"{_remark(recording, watcher, begun)}; closed")
    return recording.messages, watcher.dropped


def _shower(args: Options, watcher: Watcher, begun: float) -> Callable[[Recording], None]:
    """A function that prints the progress: one line on a terminal, lines elsewhere."""
    on_terminal = sys.stderr.isatty()
    printed_at = begun if not on_terminal else float("-inf")
    if not args.quiet:
        _say(f"recording to {args.file}; Ctrl-C ends it")

    def show(recording: Recording) -> None:
        nonlocal printed_at
        now = time.monotonic()
        if args.quiet or (not on_terminal and now - printed_at < LINE_S):
            return
        printed_at = now
        _say(_remark(recording, watcher, begun), over=on_terminal)

    return show


def _remark(recording: Recording, watcher: Watcher, begun: float) -> str:
    elapsed = time.monotonic() - begun
    parts = [
        f"{recording.path.name}: {elapsed:.1f} s",
        f"{recording.messages} messages",
        f"{recording.size / MEGABYTE:.2f} MB",
        f"{len(recording.there)} agents" if recording.there else "no agent is alive",
    ]
    if recording.files > 1:
        parts.insert(1, f"{recording.files} files")
    if recording.refused:
        parts.append(f"{recording.refused} refused")
    if recording.gaps.lost:
        parts.append(f"{recording.gaps.lost} pieces of journals missing")
    if watcher.dropped:
        parts.append(f"{watcher.dropped} LOST (overload)")
    return ", ".join(parts)


def _say(text: str, *, over: bool = False) -> None:
    clear = "\r\x1b[K" if sys.stderr.isatty() else ""
    print(f"{clear}{text}", end="" if over else "\n", file=sys.stderr, flush=True)


main: Final = Command(
    "armadico record",
    Options,
    run,
    "Record every message of one or more robots to an MCAP file, with the alive agents, their"
    " cards and all bids. Ctrl-C closes the file; after a kill it is readable up to the last"
    " second.",
    EXAMPLES,
)
