"""A picture of a robot that finds out where it is: its particles at three moments.

`python -m armadico_tools.found OUT.png [SCENARIO [SEED]]`
"""

from __future__ import annotations

import sys
import tempfile
from math import hypot
from pathlib import Path

from armadico.config.profile import load_profile
from armadico.config.scenarios import load_scenario
from armadico.config.worlds import load_world
from armadico.core.messages import Message
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import Correction, Particles, Truth
from armadico.mobile.particles import poses_of
from armadico.observe.pictures import Moment, draw_moments

LASTS_S = 90.0
NEAR_M = 0.5


def moments(scenario: str, seed: int) -> list[Moment]:
    """When it begins, half of the way, and once it is found. Raises ValueError if it is not."""
    with tempfile.TemporaryDirectory() as folder:
        anywhere = Path(folder) / "anywhere.toml"
        anywhere.write_text('[localization]\nstart = "anywhere"\n', encoding="utf-8")
        options = Options(seed=seed, parameters=str(anywhere), limit=LASTS_S)
        rehearsal = Rehearsal(prepared(load_scenario(scenario), options), options)
    robot: list[Pose2] = [(0.0, 0.0, 0.0)]
    confidence = [0.0]
    seen: list[Moment] = []

    def take(_key: str, message: Message, now: float) -> None:
        if isinstance(message, Truth):
            robot[0] = message.x, message.y, message.theta
        elif isinstance(message, Correction):
            confidence[0] = message.confidence
        elif isinstance(message, Particles) and not (seen and seen[-1].found):
            found = confidence[0] > 0.0
            seen.append(Moment(now, robot[0], poses_of(message), found=found))

    rehearsal.mesh.watch(take, Truth, Correction, Particles)
    rehearsal.run()
    if not seen or not seen[-1].found:
        raise ValueError(f"{scenario}, seed {seed}: not found in {LASTS_S:.0f} s")
    x, y, _ = seen[-1].robot
    near = sum(hypot(place[0] - x, place[1] - y) < NEAR_M for place in seen[-1].particles)
    if near < 0.9 * len(seen[-1].particles):
        raise ValueError(f"{scenario}, seed {seed}: found where it is not")
    return [seen[0], seen[len(seen) // 2], seen[-1]]


def main(arguments: list[str]) -> None:
    out, *rest = arguments
    name, seed = rest[0] if rest else "sc4", int(rest[1]) if len(rest) > 1 else 1
    scenario = load_scenario(name)
    drawn = moments(name, seed)
    body = load_profile(scenario.robot).body
    draw_moments(load_world(scenario.world), drawn, body, Path(out))
    print(f"{out}: {', '.join(f'{moment.t:.1f} s' for moment in drawn)}")


if __name__ == "__main__":
    main(sys.argv[1:])
