"""The map of an exploration, in a file: `--map`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from armadico.cli import options
from armadico.cli.additions import Addition, Start
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import option
from armadico.core.config_errors import ConfigError
from armadico.runtime.errors import AbsentError, SocietyError

if TYPE_CHECKING:
    from armadico.launch.client import Client
    from armadico.launch.run import RobotRun


@dataclass(frozen=True, kw_only=True)
class MapFile(Addition):
    commands = ("explore",)
    title = "the map"
    examples = (
        "armadico explore house --profile jackal --virtual --map house.yaml",
        "armadico explore house --profile jackal --resume house.yaml --map house.yaml",
    )

    map: Path | None = option(
        "write the map to FILE (.yaml, with its graph, or .map)", metavar="FILE"
    )

    def check(self, start: Start) -> None:
        if self.map is None:
            return
        if start.series:
            raise UsageError("--map keeps one run's map, not those of --runs")
        options.check_map(self.map)

    def driven(self, start: Start, run: RobotRun, *, interrupted: bool) -> None:  # noqa: ARG002
        """Save the map; of an interrupted run after stopping the robot."""
        if self.map is None:
            return
        if not interrupted:
            self._keep(self.map, run.client)
            return
        try:
            run.client.stop(by="armadico explore")
            self._keep(self.map, run.client)
        except (SocietyError, FailedError, ConfigError) as error:
            options.report(f"the map is not saved: {error}")

    @staticmethod
    def _keep(path: Path, client: Client) -> None:
        from armadico.cli.map import save

        try:
            try:
                options.report(save(client, path))
            except ConfigError as error:  # another process reads it, and the robot ends now
                beside = options.apart(path)
                options.report(f"{error}; the map is written beside it, as {beside}")
                options.report(save(client, beside))
        except AbsentError as error:
            raise FailedError(f"{path} is not written: {error}") from None
