"""A robot's router as a process of its own: python toy_router.py NAMESPACE [ENDPOINT [FLEET...]].

It prints `listening` once it does. It lives until its standard input is closed or a signal ends it.
"""

from __future__ import annotations

import sys

from armadico.core.shared import share
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import ZenohMesh


def main(namespace: str, endpoint: str | None = None, *fleet: str) -> None:
    share("fleet")  # as the messages of mobile robots declare it
    with ZenohMesh(namespace, topology(router=True, robot=endpoint, peers=fleet)):
        sys.stdout.write("listening\n")
        sys.stdout.flush()
        sys.stdin.read()


if __name__ == "__main__":
    main(*sys.argv[1:])
