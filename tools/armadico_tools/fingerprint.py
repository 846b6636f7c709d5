"""Hash what virtual runs publish, to compare two commits: equal lines mean equal runs.

    python -m armadico_tools.fingerprint sc1 sc4 house surveillance fleet --seed 7

Each publication's key, content and instant is hashed, from the start to the end of the run.
"""

from __future__ import annotations

import hashlib
import sys
from dataclasses import dataclass
from typing import Final

from armadico.agents.fleet.commands.run import FleetRehearsal
from armadico.cli.options import guarded
from armadico.cli.parsing import Command, argument, option
from armadico.config.scenarios import Scenario, load_scenario
from armadico.core.services import services
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal


def fingerprint(scenario: Scenario, options: Options, robots: int = 3) -> str:
    """SHA-256 of all that a run publishes, and when; a scenario with tasks has several robots."""
    scenario, digest = prepared(scenario, options), hashlib.sha256()
    run: Rehearsal | FleetRehearsal
    if scenario.tasks:
        run = FleetRehearsal(scenario, options, robots)
        namespaces = list(run.names)
    else:
        run = Rehearsal(scenario, options)
        namespaces = [run.namespace]
    for namespace in namespaces:
        run.mesh.watch(
            lambda key, message, now: digest.update(repr((key, message, now)).encode()),
            *{service.message for service in services()},
            namespace=namespace,
        )
    run.run()
    return digest.hexdigest()


@dataclass(frozen=True, kw_only=True)
class Words:
    scenarios: tuple[str, ...] = argument("scenarios (default: sc4)", nargs="*", metavar="NAME")
    seed: int = option("seed (default: 7)", default=7)
    sensors: str | None = option(
        "sensors (default: the scenario's)", choices=("ideal", "real"), metavar="KIND"
    )
    parameters: str | None = option("thesis, or a TOML file (default: the scenario's)")
    robots: int = option("robots of a fleet (default: 3)", default=3)


def run(args: Words) -> int:
    """Print a fingerprint for each scenario."""
    options = Options(seed=args.seed, sensors=args.sensors, parameters=args.parameters)
    for name in args.scenarios or ("sc4",):
        print(name, fingerprint(load_scenario(name), options, args.robots), flush=True)
    return 0


PROGRAM: Final = "python -m armadico_tools.fingerprint"
main = Command(
    PROGRAM, Words, run, "Hash what virtual runs publish.", f"  {PROGRAM} sc1 sc4 house --seed 7\n"
)

if __name__ == "__main__":
    sys.exit(guarded(PROGRAM, lambda: main(sys.argv[1:])))
