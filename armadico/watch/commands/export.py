"""Turn a recording into tables (CSV), a Rerun recording (rrd) or a bag of ROS 2 (ros2)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UnknownError, UsageError
from armadico.cli.parsing import FILE, Command, argument, option
from armadico.core.discovery import TRANSLATORS, installed

if TYPE_CHECKING:
    from armadico.watch.recordings import Warn

EXAMPLES = """\
  armadico export run.mcap --to csv                   one table a topic, in the folder run-csv
  armadico export run.mcap --to csv --out tables
  armadico export run.mcap --to rrd && rerun run.rrd
  armadico export run.mcap --to ros2 && ros2 bag play -s mcap run-ros2.mcap
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    file: Path = argument("the recording", metavar="FILE.mcap", must=FILE)
    to: str = option("the format", choices=("csv", "rrd", *installed(TRANSLATORS)), required=True)
    out: Path | None = option(
        "write this folder (csv) or file (default: beside the recording)", metavar="PATH"
    )
    namespace: str | None = option("export only this robot (default: all)", metavar="NS")
    world: str | None = option(
        "the world: its walls are drawn (rrd) or published as the map (ros2); refused with csv;"
        " default: none",
        metavar="MAP",
    )


def run(args: Options) -> int:
    """Returns 0 only if the whole recording was read."""
    if args.world is not None and args.to == "csv":
        raise UsageError("--world: tables have no walls; leave it out, or export --to rrd or ros2")
    options.need("mcap", "record")
    from armadico.watch.recordings import RecordingError, files_of

    warn, damage = options.reporter("armadico export"), list[str]()

    def damaged(text: str) -> None:
        damage.append(text)
        warn(text)

    try:
        summary = {"csv": _to_csv, "rrd": _to_rrd}.get(args.to, _to_others)(args, damaged)
    except RecordingError as error:
        raise UsageError(str(error)) from None
    except FailedError as error:
        # What was asked for may be in what could not be read.
        raise (UnknownError(str(error)) if damage else error) from None
    except OSError as error:
        where = error.filename or _out(args)  # the error of a full disk names no file
        raise FailedError(f"{where}: {error.strerror or error}") from None
    print(summary)
    if others := [path.name for path in files_of(args.file)[1:]]:
        last = f" to {others[-1]}" if others[1:] else ""
        warn(f"only {args.file.name} was exported; its recording continues in {others[0]}{last}")
    if damage:
        print("The recording is damaged: missing messages were not exported.")
    return options.UNKNOWN if damage else 0


def _to_csv(args: Options, warn: Warn) -> str:
    from armadico.watch.export import Tables
    from armadico.watch.recordings import rows

    folder = _out(args)
    if any(folder.glob("*.csv")):  # tables of topics that this recording lacks would stay
        raise FailedError(f"{folder} holds tables already; name another folder with --out")
    with Tables(folder) as tables:
        for row in rows(args.file, warn):
            if args.namespace in (None, row.namespace):
                tables.write(row)
    if not tables.rows:
        raise FailedError(f"{args.file} holds no messages" + _of(args))
    return f"{tables.rows} messages of {len(tables.topics)} topics in {folder}"


def _to_rrd(args: Options, warn: Warn) -> str:
    from armadico.watch.commands.dashboard import zones
    from armadico.watch.export import to_rrd

    out = _out(args)
    options.need("rerun", "dashboard")
    count = to_rrd(
        args.file,
        out,
        args.namespace,
        options.world_of(args.world),
        zones(),
        warn,
    )
    if not count:
        raise FailedError(f"{args.file} holds no messages" + _of(args))
    return f"{count} messages in {out}"


def _to_others(args: Options, warn: Warn) -> str:
    from armadico.watch.export import translated

    out = _out(args)
    if out.suffix != ".mcap":
        raise UsageError(f"--out {out}: the name of a recording must end with .mcap")
    try:
        count = translated(
            args.file,
            out,
            args.to,
            args.namespace,
            warn,
            options.world_of(args.world),
        )
    except FileExistsError:
        raise FailedError(f"{out} exists already; name another file with --out") from None
    if not count:
        out.unlink(missing_ok=True)
        raise FailedError(f"{args.file} holds no message that {args.to} can express" + _of(args))
    return f"{count} samples in {out}"


def _out(args: Options) -> Path:
    """The file or folder to write."""
    beside = {"csv": f"{args.file.stem}-csv", "rrd": f"{args.file.stem}.rrd"}.get(
        args.to, f"{args.file.stem}-{args.to}.mcap"
    )
    chosen: Path | None = args.out
    return args.file.with_name(beside) if chosen is None else chosen


def _of(args: Options) -> str:
    return "" if args.namespace is None else f" of {args.namespace!r}"


main: Final = Command(
    "armadico export",
    Options,
    run,
    "Convert a recording of `armadico record`. A truncated recording is converted as far as it"
    " can be read, and the exit code is then 3.",
    EXAMPLES,
)
