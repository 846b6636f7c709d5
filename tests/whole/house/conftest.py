"""The house is a checkout: a source distribution has files in place of its links, and no rules."""

from __future__ import annotations

from tests.whole.house.tree import PARTS, ROOT

LINKED = all((ROOT / "armadico" / part).is_symlink() for part in PARTS)

collect_ignore_glob = [] if LINKED else ["test_*.py"]
