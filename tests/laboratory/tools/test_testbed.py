"""The testbed of real processes on this machine."""

from __future__ import annotations

import sys
from pathlib import Path

from armadico_tools.testbed import Place


def test_what_a_killed_process_leaves_is_removed_with_the_testbed() -> None:
    makes = "import tempfile; print(tempfile.mkdtemp())"
    with Place("left") as place:
        made = Path(place.call("localhost", sys.executable, "-c", makes).strip())
        assert made.is_dir()
    assert not made.exists()
