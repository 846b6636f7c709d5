"""Renew the certificates of this computer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from armadico.cli.options import FailedError
from armadico.cli.parsing import Command, argument, group
from armadico.core.config_errors import ConfigError
from armadico.core.errors import UnknownNameError
from armadico.keys.commands.common import Society, addresses, hours_option, issuer_of, now
from armadico.keys.store import Identity, Store

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
    store, where = args.society.store, args.society.where
    here = {identity.name: identity for identity in store.identities()}
    names = [n if n in here else f"{where.namespace}/{n}" for n in args.names] or list(here)
    for name in names:
        if name not in here:
            raise UnknownNameError("identity", name, here)
    chosen = [here[name] for name in names]
    if store.issues:
        known = () if where.table is None else addresses(where.table)
        issuer = issuer_of(args.society, args.hours)
        renewed, refused = issuer.renew(chosen, now(), addresses=known)
    else:
        renewed, refused = _by_the_robot(store, chosen, where.known)
    if renewed:
        print(f"{store.folder}: {len(renewed)} certificates are new")
    if refused:
        raise FailedError("; ".join(refused))
    return 0


def _by_the_robot(
    store: Store, identities: Sequence[Identity], endpoints: Sequence[str]
) -> tuple[list[str], list[str]]:
    """Renew by the robot's port; returns as `Issuer.renew`."""
    from armadico.keys.asking import renewed

    done: list[str] = []
    refused: list[str] = []
    for identity in identities:
        try:
            renewed(store, identity, endpoints)
        except ConfigError as error:
            refused.append(f"{identity.name}: {error}")
        else:
            done.append(identity.name)
    return done, refused


COMMAND: Final = Command(
    "armadico keys renew",
    Options,
    run,
    "Make new certificates for the keys of this computer, by the authority's key if it is here,"
    " else by the robot's port. Private keys, passwords and links stay. A running process renews"
    " its own certificate; the robot's is renewed by this command, once a year.",
    EXAMPLES,
)
