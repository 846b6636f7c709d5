"""What a virtual run publishes, as one line: whether a change of code changed any of it.

    python -m armadico_tools.fingerprint sc4 --seed 7

hashes each publication's key, content and instant. Two builds or commits that print the same line
drive the same run.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Sequence

from armadico.config.scenarios import Scenario, load_scenario, with_sensors
from armadico.core.services import services
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal


def fingerprint(scenario: Scenario, options: Options) -> str:
    """SHA-256 of all that is published from the start to the goal, and when."""
    rehearsal, digest = Rehearsal(scenario, options), hashlib.sha256()
    rehearsal.mesh.watch(
        lambda key, message, now: digest.update(repr((key, message, now)).encode()),
        *{service.message for service in services()},
    )
    rehearsal.run()
    return digest.hexdigest()


def main(argv: Sequence[str] | None = None) -> int:
    """Print a fingerprint for each scenario."""
    parser = argparse.ArgumentParser(description="A hash of all that a virtual run publishes.")
    parser.add_argument("scenarios", nargs="*", default=["sc4"])
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--sensors", choices=("ideal", "real"), help="not the scenario's")
    parser.add_argument("--parameters", help="thesis, or a TOML file")
    args = parser.parse_args(argv)
    for name in args.scenarios:
        options = Options(seed=args.seed, parameters=args.parameters)
        scenario = load_scenario(name)
        if args.sensors is not None:
            scenario = with_sensors(scenario, args.sensors)
        print(name, fingerprint(scenario, options))
    return 0


if __name__ == "__main__":
    sys.exit(main())
