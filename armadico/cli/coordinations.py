"""Shows the coordinations that `--coordination` takes."""

from __future__ import annotations

import textwrap
from typing import Final

LIST: Final = "list"
"""The name that shows them."""

WIDTH: Final = 76


def show() -> int:
    """Print each with what decides, what a preset lacks of its system, and what is not installed.

    Returns 0.
    """
    from armadico.core.mechanisms import all_coordinations, lacks

    found = all_coordinations()
    if not found:
        print("no coordination is installed besides ballots, the default")
    for name, each in sorted(found.items()):
        about, without = getattr(each, "about", ""), getattr(each, "without", "")
        text = f"{about}; missing or different: {without}" if without else about
        print(name)
        print(textwrap.indent(textwrap.fill(text, WIDTH), "    "))
        if lacking := lacks(each, {}):
            print(f"    cannot be chosen here: {lacking}")
    return 0
