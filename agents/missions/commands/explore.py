"""Explore an unknown environment, build a map, and return to the start."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli.additions import Addition, added
from armadico.cli.options import UsageError
from armadico.cli.parsing import Command, option
from armadico.cli.run import answering, drive, refused
from armadico.cli.run_options import Drive, choose

if TYPE_CHECKING:
    from armadico.agents.missions.messages import ExploreRequest
    from armadico.config.scenarios import Scenario

EXAMPLES: Final = """\
  armadico explore house --profile jackal --virtual --seed 7    in one process, repeatable
  armadico explore house --profile jackal --resume house.yaml
  armadico explore --world plan.map --profile jackal --start 1 1 0 --within 0 0 8 6
  armadico explore house --sensors ideal --virtual      by sonars, without errors
  armadico explore --profile turtlebot4 --robot ros2://    around a real robot
  armadico explore my.toml --attach --hosts lab.toml    in a running society
"""


FARTHEST: Final = 1e6  # m; messages have no coordinates beyond that


@dataclass(frozen=True, kw_only=True)
class Options(Drive):
    within: tuple[float, float, float, float] | None = option(
        "the rectangle to explore, m (default: the world's; without one 10 m around 0 0)",
        metavar=("X1", "Y1", "X2", "Y2"),
    )
    resume: str | None = option(
        "extend the saved map FILE (.yaml); the robot finds its place on it", metavar="FILE"
    )
    additions: tuple[Addition, ...] = added("explore")

    @property
    def anywhere(self) -> bool:
        """See `Drive`. A robot's surroundings are its own."""
        return super().anywhere or self.robot is not None or self.attach


def run(args: Options) -> int:
    """Explore; return 0 only if all is known, without a collision, and the robot is back."""
    from armadico.config.scenarios import exploring

    with answering(args):
        _check(args)
        if args.resume is not None:
            args = replace(args, resume=str(Path(args.resume).resolve()))

        def explored(scenario: Scenario) -> Scenario:
            _check_sensors(args, scenario)
            return exploring(scenario, args.within)

        scenario, chosen = choose(args, somewhere=False, change=explored)
        return drive(args, scenario, chosen)


def _check(args: Options) -> None:
    """Raises UsageError, ConfigError or FailedError before anything moves."""
    if args.within is not None:
        x1, y1, x2, y2 = args.within
        if not (-FARTHEST <= x1 < x2 <= FARTHEST and -FARTHEST <= y1 < y2 <= FARTHEST):
            raise UsageError(f"--within: expected X1 < X2 and Y1 < Y2, within {FARTHEST:,.0f} m")
    if args.attach and args.resume is not None:
        raise UsageError(
            "--resume needs a mapping agent of this run; with --attach use `armadico map load`"
        )
    if args.resume is not None:
        from armadico.config import grid_map

        if Path(args.resume).suffix not in (".yaml", ".yml"):
            raise UsageError(f"--resume {args.resume}: expected the .yaml of a saved map")
        grid_map.read(args.resume)


def _check_sensors(args: Options, scenario: Scenario) -> None:
    """Raises UsageError for a robot that cannot map with its sensors."""
    from armadico.config.scenarios import slams, society

    if args.attach or scenario.sensors == society().ideal.sensors:
        return
    if not slams(scenario.robot):
        raise UsageError(
            f"{scenario.name}: {scenario.robot} has no laser, and sonars are too ambiguous"
            " to map by while the odometry drifts; choose a robot with a laser (--profile jackal)"
            " or sensors without error (--sensors ideal)"
        )
    if args.resume is not None:
        from armadico.config import graph_file

        graph_file.of_map(Path(args.resume))


def exploration(scenario: Scenario) -> ExploreRequest:
    """Return the request to explore a scenario's world; the agents know only its bounds."""
    from armadico.agents.missions.messages import ExploreRequest
    from armadico.config.worlds import load_world
    from armadico.mobile.messages import Waypoint

    assert scenario.goal is not None, "it ends somewhere"
    within = scenario.within or load_world(scenario.world).bounds
    return ExploreRequest(*within, Waypoint(*scenario.goal))


main: Final = Command(
    "armadico explore",
    Options,
    run,
    "Drive to the frontiers of the map, one after another, until everything reachable is known,"
    " and then return. No agent knows the world. A robot with a laser makes the map by SLAM (agent"
    " slam). With --sensors ideal the agent mapping makes it at the pose of the odometry, also by"
    " sonars.",
    EXAMPLES,
    refused,
)
