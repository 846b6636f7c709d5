"""What the compiled build has to be told in the sources (`setup.py`); interpreted, it says nothing.

Classes that are compiled are closed. `Agent` is for everybody to derive from.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

__all__ = ("mypyc_attr",)

if TYPE_CHECKING:
    from mypy_extensions import mypyc_attr
else:

    def mypyc_attr(**_):
        """Leave the class as it is."""
        return lambda kind: kind
