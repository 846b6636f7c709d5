"""Judge a plug-in by its contract: `python -m armadico.testing robot PROFILE`."""

from __future__ import annotations

import sys

from armadico.core.judgement import all_of
from armadico.testing.contract import Contract

USAGE = "usage: python -m armadico.testing robot PROFILE"


def main(words: list[str]) -> int:
    """Print each judgement; return 0 for yes, 1 for no, 3 for unknown, 2 for wrong usage."""
    contract = _contract(*words) if len(words) == 2 else None
    if contract is None:
        sys.stderr.write(USAGE + "\n")
        return 2
    found = contract.judge()
    wide = max(map(len, found))
    for name, judgement in found.items():
        cure = f" -> {judgement.cure}" if judgement.cure else ""
        sys.stdout.write(f"{name:{wide}}  {judgement}{cure}\n")
    return all_of(found.values()).exit_code


def _contract(kind: str, name: str) -> Contract | None:
    if kind == "robot":
        from armadico.testing.robots import RobotContract

        return type("Judged", (RobotContract,), {"profile": name})()
    return None


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
