"""What the verbs of `armadico keys` share: the folder of keys, and the host table."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import UsageError
from armadico.cli.parsing import more_than, option
from armadico.keys.store import Store

if TYPE_CHECKING:
    from armadico.config.endpoints import Endpoints
    from armadico.config.hosts import HostTable

HOURS_HELP: Final = "a client's certificate is valid for so long (default: %(default)s)"


@dataclass(frozen=True, kw_only=True)
class Society(options.Mesh):
    """The society whose keys are meant; no connection to it is made."""

    connect: tuple[str, ...] = ()

    @property
    def where(self) -> Endpoints:
        return self.endpoints()

    @property
    def table(self) -> HostTable:
        """The host table. Raises UsageError without one, or if it has no keys."""
        table = self.where.table
        if table is None:
            raise UsageError(
                f"which host table? Add --hosts lab.toml, or set {options.HOSTS_VARIABLE}"
            )
        if table.keys is None:
            raise UsageError(
                f'{table.file} has no keys: write keys = "keys", say, above its first host; that is'
                " the folder of keys, beside the table"
            )
        return table

    @property
    def store(self) -> Store:
        """The folder of keys: the table's, or that of the society on this computer."""
        where = self.where
        folder = where.keys if where.table is None else self.table.keys_folder
        if folder is None:
            folder = self.table.keys_folder  # raises
        assert folder is not None
        return Store(folder)


def hours_option() -> float:
    return option(HOURS_HELP, default=24.0, metavar="HOURS", must=more_than(0))


def now() -> datetime:
    return datetime.now(UTC)


def addresses(table: HostTable) -> tuple[str, ...]:
    """The addresses of the robot's router."""
    name = table.robots_host
    return () if name is None else table.host(name).addresses


__all__ = ["Path", "Society", "addresses", "hours_option", "now", "replace"]
