"""Options that the laboratory's commands share."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from armadico.cli.options import UsageError
from armadico.cli.parsing import at_least, flag, option
from armadico.core.errors import no_such
from armadico.core.installed import entries

if TYPE_CHECKING:
    from armadico.cli.pool import Pool

POOLS: Final = "armadico.pools"
"""Entry points: functions of (address, jobs) that return a context manager of a `Pool`."""


@dataclass(frozen=True, kw_only=True)
class Series:
    """How a series of runs is run and printed."""

    jobs: int | None = option(
        "run J processes, or jobs of a cluster (default: one per core)",
        metavar="J",
        must=at_least(1),
    )
    on: str | None = option(
        "run on a cluster: dask://HOST:PORT, or slurm (default: on the cores of this computer)",
        metavar="CLUSTER",
    )
    json: bool = flag("print the results as JSON")

    @property
    def processes(self) -> int:
        return self.jobs or os.cpu_count() or 1

    @contextmanager
    def workers(self) -> Iterator[Pool]:
        """Where the runs are run. Raises UsageError for a cluster that cannot be used."""
        from armadico.cli.pool import Local

        if self.on is None:
            yield Local(self.processes)
            return
        name, _, address = self.on.partition("://")
        pools = {point.name: point for point in entries(POOLS)}
        if name not in pools:
            known = no_such("cluster", name, pools)
            raise UsageError(f"--on {self.on}: {known}; expected dask://HOST:PORT or slurm")
        with pools[name].load()(address, self.jobs) as pool:
            yield pool
