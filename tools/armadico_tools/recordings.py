"""The recording that every change to an agent is tried on: `python -m armadico_tools.recordings`.

Without options it is replayed; the exit code is 1 at the first difference. `--update` makes it
anew, for a change of what agents decide that is meant: the commit says what it was and why.

It is a drive through two doors that avoid, gothrough and goto share, in which goto is killed once
and started again; of what was said only the agents' journals are kept.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from armadico.cli import options
from armadico.config.scenarios import load_scenario
from armadico.core.messages import PROTOCOL
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.observe.journals import JOURNAL
from armadico.observe.recorder import PROFILE, McapFile
from armadico.observe.recordings import Past, rows
from armadico.observe.replay import Outcome, replayed
from armadico.observe.virtual_recording import Recorded

SHIPPED: Final = Path(__file__).resolve().parents[2] / "tests" / "recordings" / "sc4.mcap"
"""Where it is in a checkout."""

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
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        file = McapFile(path, {PROFILE: {"protocol": str(PROTOCOL), "seed": str(SEED)}})
        for row in rows(whole, options.say):
            if row.key.startswith(JOURNAL):
                file.add(row.namespace, row.key, None, row.data, row.t)
        file.close()


def replay(path: Path) -> list[Outcome]:
    """What everybody in it decides now. Raises RecordingError and OSError."""
    past = Past(path, options.say)
    past.check()
    return [replayed(journal) for journal in past.journals()]


def main(argv: Sequence[str] | None = None) -> int:
    """Replay it, or make it anew."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--update", action="store_true", help="make it anew")
    if parser.parse_args(argv).update:
        make(SHIPPED)
        options.say(f"{SHIPPED}: made anew")
    outcomes = replay(SHIPPED)
    for outcome in outcomes:
        if not outcome.equal:
            print(f"{outcome.instance}: {outcome.refusal or outcome.difference}")
    return 0 if all(outcome.equal for outcome in outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
