"""The compiled simulated robot drives the same runs as the interpreted one, to the last bit."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.house.tree import ROOT, package_files

COMPILED = ROOT / ".venv-compiled" / "bin" / "python"
WHERE = "import armadico; print(armadico.__path__[0])"


def said(python: Path | str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run it away from the checkout's own packages."""
    return subprocess.run(
        [str(python), "-P", *words], capture_output=True, text=True, check=True, cwd=ROOT
    )


@pytest.fixture(scope="module")
def compiled() -> Path:
    """A Python whose simulated robot is compiled in an installation of what is here."""
    if not COMPILED.exists():
        pytest.skip("no compiled simulated robot here: make compiled")
    site = Path(said(COMPILED, "-c", WHERE).stdout.strip()).parent
    for name, path in package_files():
        if not (site / name).exists() or (site / name).read_bytes() != path.read_bytes():
            pytest.skip(f"compiled before {name} was changed: make compiled")
    return COMPILED


@pytest.mark.parametrize("words", [("sc4", "sc1"), ("sc3", "--parameters", "thesis")])
def test_compiled_and_interpreted_publish_the_same(compiled: Path, words: tuple[str, ...]) -> None:
    module = ("-m", "armadico.tools.fingerprint", *words)
    one, other = said(sys.executable, *module), said(compiled, *module)
    assert "pure Python" in one.stderr
    assert "compiled" in other.stderr
    assert one.stdout == other.stdout
