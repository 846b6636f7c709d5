"""The picture of a run: `--plot`, `--no-plot`."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.additions import Addition, Start
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import flag, option

if TYPE_CHECKING:
    from armadico.launch.api import Run

NOTHING_DRAWS: Final = "no picture: matplotlib is missing; pip install 'armadico[plot]'"


@dataclass(frozen=True, kw_only=True)
class Picture(Addition):
    title = "to watch, draw and record"
    fleets = True

    plot: Path | None = option(
        "write the picture to a PNG file (default: runs/SCENARIO.png if live, else none)",
        metavar="FILE",
    )
    no_plot: bool = flag("draw no picture")

    def check(self, start: Start) -> None:
        """Raises FailedError if the picture that is asked for cannot be drawn or written."""
        if self.plot is None or start.scenario is None:
            return
        if not start.alone:
            name = start.scenario.name
            raise UsageError(f"--plot is for the run of one robot, and {name} is a fleet's")
        if self.no_plot:
            return
        if find_spec("matplotlib") is None:
            raise FailedError(NOTHING_DRAWS)
        for path in (start.of_run(self.plot, seed) for seed in start.seeds):
            try:
                new = not path.exists()
                path.open("ab").close()
                if new:
                    path.unlink()
            except OSError as error:
                raise FailedError(f"cannot write the picture {path}: {error.strerror}") from None

    def done(self, start: Start, run: Run) -> None:
        """Draw the world, the path coloured by holder and the echoes.

        Without a picture that is asked for, the command fails.
        """
        if self.no_plot or (self.plot is None and start.virtual):
            return
        path = start.of_run(self.plot or Path("runs") / f"{run.scenario.name}.png")
        if why := self._fault(path, run):
            if self.plot is not None:
                raise OSError(why)
            options.report(why)

    @staticmethod
    def _fault(path: Path, run: Run) -> str:
        """Draw; returns why there is no picture, or ""."""
        if not run.marks:
            return "no picture: the robot has reported no pose"
        try:
            run.plot(path)
        except ImportError:
            return NOTHING_DRAWS
        except OSError as error:
            with suppress(OSError):
                path.unlink()  # it is incomplete
            return f"no picture: cannot write {path}: {error.strerror}"
        options.report(f"picture: {path}")
        return ""
