"""Write the recordings that tests read: `python -m tests.laboratory.recorded`.

Without options it writes `tests/recordings/sc4.mcap`, after an intended change of decisions; the
commit states the change and its reason. In this drive avoid, gothrough and goto share two doors,
and goto is killed and restarted. Only the agents' journals are kept.

The other recording, of ten minutes, is of real processes. `--live FILE` copies such a recording
without large messages that no test reads.

    armadico up surveillance &
    armadico record ten.mcap --duration 600 &
    armadico mission run surveillance --attach && armadico mission run rounds --attach
    python -m tests.laboratory.recorded --live ten.mcap
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from armadico.cli import options
from armadico.cli.parsing import Command, option
from armadico.config.scenarios import load_scenario
from armadico.core.messages import PROTOCOL, BidRecord, JournalPiece
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import Correction, LocalMap, Particles, Sonar
from armadico.mobile.obstacles import Obstacles
from armadico.observe.journals import JOURNAL
from armadico.watch.recorder import PROFILE, McapFile
from armadico.watch.recordings import Row, kinds, rows
from armadico.watch.virtual_recording import Recorded

SHIPPED: Final = Path(__file__).resolve().parents[1] / "recordings" / "sc4.mcap"
LIVE: Final = SHIPPED.with_name("surveillance.mcap")

LEFT_OUT: Final = (JournalPiece, BidRecord, LocalMap, Obstacles, Particles, Sonar, Correction)
"""Four fifths of a live recording's bytes, which the checker of promises does not need."""

SEED: Final = 11
LIMIT_S: Final = 10.0
KILLED_S, BACK_S = 5.0, 5.6
"""When goto is killed and restarted, s."""


def make(path: Path) -> None:
    """Drive, and write the journals into a file. Raises OSError."""
    chosen = Options(seed=SEED, limit=LIMIT_S, sensors="ideal")  # sums by numpy may differ
    made = Rehearsal(prepared(load_scenario("sc4"), chosen), chosen)

    def back(_a: object, _b: object) -> None:
        made.enter("goto")

    made.mesh.call_at(KILLED_S, lambda _a, _b: made.mesh.node("goto").kill())
    made.mesh.call_at(BACK_S, back)
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "run.mcap"
        with Recorded(made.mesh, whole, made.namespace):
            made.run()
        about = {"protocol": str(PROTOCOL), "seed": str(SEED)}
        copy(whole, path, lambda row: row.key.startswith(JOURNAL), about)


def copy(source: Path, path: Path, kept: Callable[[Row], bool], about: Mapping[str, str]) -> None:
    """Copy the messages of a recording that `kept` selects. Raises RecordingError and OSError."""
    path.unlink(missing_ok=True)
    file = McapFile(path, {PROFILE: about})
    for row in rows(source, options.report):
        if kept(row):
            file.add(row.namespace, row.key, kinds().get(row.schema), row.data, row.t)
    file.close()


@dataclass(frozen=True, kw_only=True)
class Words:
    live: Path | None = option("copy FILE for the tests (default: make sc4.mcap)", metavar="FILE")


def run(args: Words) -> int:
    """Write one of the two recordings."""
    if args.live is None:
        make(SHIPPED)
        return 0
    about: dict[str, str] = {}
    next(rows(args.live, options.report, about), None)
    copy(args.live, LIVE, lambda r: kinds().get(r.schema, JournalPiece) not in LEFT_OUT, about)
    return 0


PROGRAM: Final = "python -m tests.laboratory.recorded"
main = Command(PROGRAM, Words, run, str(__doc__), f"  {PROGRAM} --live ten.mcap\n")

if __name__ == "__main__":
    sys.exit(options.guarded(PROGRAM, lambda: main(sys.argv[1:])))
