"""Hash what virtual runs publish, to compare two commits: equal lines mean equal runs.

    python -m armadico_tools.fingerprint sc1 sc4 house surveillance fleet --seed 7

Each publication's key, content and instant is hashed, from the start to the end of the run.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Sequence

from armadico.agents.fleet.commands.run import FleetRehearsal
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


def main(argv: Sequence[str] | None = None) -> int:
    """Print a fingerprint for each scenario."""
    parser = argparse.ArgumentParser(description="Hash what virtual runs publish.")
    parser.add_argument("scenarios", nargs="*", default=["sc4"])
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument(
        "--sensors", choices=("ideal", "real"), help="sensors (default: the scenario's)"
    )
    parser.add_argument("--parameters", help="thesis, or a TOML file (default: the scenario's)")
    parser.add_argument("--robots", type=int, default=3, help="robots of a fleet (default: 3)")
    args = parser.parse_args(argv)
    options = Options(seed=args.seed, sensors=args.sensors, parameters=args.parameters)
    for name in args.scenarios:
        print(name, fingerprint(load_scenario(name), options, args.robots), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
