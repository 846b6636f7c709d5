"""What the verbs of `armadico keys` share: the folder of keys, the host table, and issuing."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import between, option
from armadico.keys.store import Member, Store
from armadico.mesh.door import PERSON, person
from armadico.mesh.topology import HOSTS_VARIABLE

if TYPE_CHECKING:
    from armadico.config.endpoints import Endpoints
    from armadico.config.hosts import HostTable
    from armadico.keys.issuing import Issuer

HOURS_HELP: Final = "a client's certificate is valid for so many hours (default: %(default)g)"
AUTHORITY: Final = "authority"
"""The holder of what is issued on the authority's computer, if that is no host of the table."""

OUT_HELP: Final = (
    "write an archive for another computer, or a folder if the name does not end in .tar (default:"
)


@dataclass(frozen=True, kw_only=True)
class Society(options.Mesh):
    """The society whose keys are meant; no connection to it is made."""

    connect: tuple[str, ...] = ()
    open: bool = False

    @property
    def where(self) -> Endpoints:
        return self.endpoints()

    @property
    def table(self) -> HostTable:
        """The host table. Raises UsageError without one, or if it has no keys."""
        table = self.where.table
        if table is None:
            raise UsageError(f"which host table? Add --hosts lab.toml, or set {HOSTS_VARIABLE}")
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
        assert folder is not None, "a table with keys has a folder"
        return Store(folder)

    def users(self, named: Sequence[str]) -> Sequence[str]:
        """The users for whom keys are made; by default the one of this process."""
        return named or (person().removeprefix(PERSON),)


def hours_option() -> float:
    """The field of the validity of certificates, h."""
    return option(HOURS_HELP, default=24.0, metavar="HOURS", must=between(0.01, 87_600))


def now() -> datetime:
    return datetime.now(UTC)


def addresses(table: HostTable) -> tuple[str, ...]:
    """The addresses of the robot's router."""
    name = table.robots_host
    return () if name is None else table.host(name).addresses


def issuer_of(society: Society, hours: float) -> Issuer:
    """The authority, with the identities of the table in its list. Raises ConfigError.

    Persons are listed once they get a key.
    """
    from armadico.keys.issuing import Issuer
    from armadico.keys.members import of_table

    issuer = Issuer.of(society.store, hours)
    table = society.where.table
    if table is not None:
        issuer.list_all(of_table(table, society.where.namespace, ()))
    return issuer


def given_out(
    issuer: Issuer, members: Iterable[Member], holder: str, file: Path | None, society: Society
) -> tuple[Member, ...]:
    """Issue identities into an archive or a folder, by default this computer's; say so.

    The `holder` is that of the archive; here it is this computer. Raises FailedError if the folder
    exists.
    """
    from armadico.keys.issuing import archive

    table = society.where.table
    known = () if table is None else addresses(table)
    if file is not None and file.suffix == ".tar":
        name = issuer.store.folder.name
        with tempfile.TemporaryDirectory(prefix="armadico-keys-") as folder:
            into = Store(Path(folder, name))
            given = issuer.give(members, holder, into, now(), addresses=known)
            archive(into.folder, name, file)
        print(f"{file}: {_counted(given)}; unpack it beside the host table: tar -xf {file.name}")
        return given
    if file is None:
        holder, into = society.where.name or AUTHORITY, issuer.store
    elif file.exists() and any(file.iterdir()):
        raise FailedError(f"{file} is not empty; name another folder, or an archive")
    else:
        into = Store(file)
    given = issuer.give(members, holder, into, now(), addresses=known)
    print(f"{into.folder}: {_counted(given)}")
    return given


def _counted(given: Sequence[Member]) -> str:
    return f"{len(given)} key{'s' if len(given) != 1 else ''}"
