"""The recordings that tests read: `python -m armadico_tools.recordings`.

Without options the one that every change to an agent is tried on is replayed; the exit code is 1 at
the first difference. `--update` makes it anew, for a change of what agents decide that is meant:
the commit says what it was and why. It is a drive through two doors that avoid, gothrough and goto
share, in which goto is killed once and started again; of what was said only the agents' journals
are kept.

The other one, of ten minutes, was made by real processes: `--live FILE` takes such a recording, and
leaves out of it what is large and what no test looks at.

    armadico up surveillance &
    armadico record ten.mcap --duration 600 &
    armadico mission run surveillance --attach && armadico mission run rounds --attach
    python -m armadico_tools.recordings --live ten.mcap
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from armadico.cli import options
from armadico.config.scenarios import load_scenario
from armadico.core.messages import PROTOCOL, BidRecord, JournalPiece
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import Correction, LocalMap, Particles, Sonar
from armadico.mobile.obstacles import Obstacles
from armadico.observe.journals import JOURNAL
from armadico.observe.recorder import PROFILE, McapFile
from armadico.observe.recordings import KINDS, Past, RecordingError, Row, rows
from armadico.observe.replay import Outcome, replayed
from armadico.observe.virtual_recording import Recorded

SHIPPED: Final = Path(__file__).resolve().parents[2] / "tests" / "recordings" / "sc4.mcap"
"""Where it is in a checkout."""

LIVE: Final = SHIPPED.with_name("surveillance.mcap")

LEFT_OUT: Final = (
    *(JournalPiece, BidRecord),
    *(LocalMap, Obstacles, Particles, Sonar),
    Correction,
)
"""Of a live recording: four fifths of its bytes. The checker of promises needs none of it."""

SEED: Final = 11
LIMIT_S: Final = 10.0
KILLED_S, BACK_S = 5.0, 5.6
"""When goto is killed, and started again, s."""


def make(path: Path) -> None:
    """Drive it, and write the journals into a file, over one that is there. Raises OSError."""
    chosen = Options(seed=SEED, limit=LIMIT_S, sensors="ideal")  # nothing of what numpy sums
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
        _copy(whole, path, lambda row: row.key.startswith(JOURNAL), about)


def keep(live: Path, path: Path) -> None:
    """Copy a live recording but for what is left out. Raises RecordingError and OSError."""
    about: dict[str, str] = {}
    next(rows(live, options.say, about), None)
    _copy(live, path, lambda r: KINDS.get(r.schema, JournalPiece) not in LEFT_OUT, about)


def _copy(source: Path, path: Path, kept: Callable[[Row], bool], about: Mapping[str, str]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    file = McapFile(path, {PROFILE: about})
    for row in rows(source, options.say):
        if kept(row):
            file.add(row.namespace, row.key, KINDS.get(row.schema), row.data, row.t)
    file.close()


def replay(path: Path) -> list[Outcome]:
    """What everybody in it decides now. Raises RecordingError and OSError."""
    past = Past(path, options.say)
    past.check()
    return [replayed(journal) for journal in past.journals()]


def main(argv: Sequence[str] | None = None) -> int:
    """Replay the one, make it anew, or the other."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--update", action="store_true", help="make the replayed one anew")
    parser.add_argument("--live", type=Path, metavar="FILE", help="keep this one for the tests")
    args = parser.parse_args(argv)
    if args.live is not None:
        try:
            keep(args.live, LIVE)
        except (OSError, RecordingError) as error:
            options.say(f"{args.live}: {error}")
            return 1
        options.say(f"{LIVE}: {LIVE.stat().st_size / 1e6:.1f} MB")
        return 0
    if args.update:
        make(SHIPPED)
        options.say(f"{SHIPPED}: made anew")
    outcomes = replay(SHIPPED)
    for outcome in outcomes:
        if not outcome.equal:
            print(f"{outcome.instance}: {outcome.refusal or outcome.difference}")
    return 0 if all(outcome.equal for outcome in outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
