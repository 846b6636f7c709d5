"""What the compiled build has to be told in the sources (`setup.py`), and whether this is one.

Classes that are compiled are closed. `Agent` is for everybody to derive from.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

__all__ = ("is_compiled", "mypyc_attr")

if TYPE_CHECKING:
    from mypy_extensions import mypyc_attr
else:

    def mypyc_attr(**_):
        """Leave the class as it is."""
        return lambda kind: kind


def is_compiled() -> bool:
    """Whether what agents stand on is machine code here (`make compiled`)."""
    found = find_spec("armadico.core.coordination")
    return found is not None and not (found.origin or "").endswith(".py")
