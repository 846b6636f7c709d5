"""No call of any command ends in a traceback, whatever its options are."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from armadico.core.discovery import COMMANDS, installed
from tests.programs import SOON

CASES = 20
"""For each command; more found no more."""

FUZZ = Path(__file__).with_name("fuzz.py")


@pytest.mark.long
@pytest.mark.parametrize("half", [0, 1])
def test_whatever_is_typed_is_answered_in_words(tmp_path: Path, half: int) -> None:
    names = sorted(installed(COMMANDS))[half::2]
    done = subprocess.run(
        [sys.executable, "-P", FUZZ, "11", str(CASES), *names],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        errors="replace",
        timeout=2 * SOON,
        check=False,
    )
    assert done.stdout == ""
    assert done.returncode == 0, done.stderr
