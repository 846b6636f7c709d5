"""Renew the certificates of this computer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from armadico.cli.options import FailedError
from armadico.cli.parsing import Command, argument, group
from armadico.core.errors import UnknownNameError
from armadico.keys.commands.common import Society, addresses, hours_option, issuer_of, now

EXAMPLES: Final = """\
  armadico keys renew            all of this computer
  armadico keys renew goto
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    names: tuple[str, ...] = argument(
        "the identities (default: all of this computer)", nargs="*", metavar="NAME"
    )
    hours: float = hours_option()
    society: Society = group(Society, "the society")


def run(args: Options) -> int:
    issuer, where = issuer_of(args.society, args.hours), args.society.where
    here = {identity.name: identity for identity in issuer.store.identities()}
    names = [n if n in here else f"{where.namespace}/{n}" for n in args.names] or list(here)
    for name in names:
        if name not in here:
            raise UnknownNameError("identity", name, here)
    known = () if where.table is None else addresses(where.table)
    renewed, refused = issuer.renew([here[name] for name in names], now(), addresses=known)
    if renewed:
        print(f"{issuer.store.folder}: {len(renewed)} certificates are new")
    if refused:
        raise FailedError("; ".join(refused))
    return 0


COMMAND: Final = Command(
    "armadico keys renew",
    Options,
    run,
    "Make new certificates for the keys of this computer, which must have the authority's key."
    " Private keys and passwords stay. The robot agent reads its own certificate when it starts.",
    EXAMPLES,
)
