"""What is compiled drives the same runs as the interpreted sources, to the last bit."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.blocks import files
from tests.house.tree import ROOT, package_files

COMPILED = ROOT / ".venv-compiled" / "bin" / "python"
WHERE = "import armadico; print(armadico.__path__[0])"

NEWCOMER = """
import sys

sys.path.insert(0, sys.argv[1])
from wall_follower import WallFollower

from armadico.config.scenarios import ideal, load_scenario
from armadico.launch.virtual import Rehearsal
from armadico.launch.society import Options

rehearsal = Rehearsal(ideal(load_scenario("sc2")), Options(without=("gothrough",)))
rehearsal.start()
rehearsal.begin()
rehearsal.mesh.run(rehearsal.mesh.now + 2.0)
node = rehearsal.add(WallFollower)
rehearsal.mesh.run(rehearsal.mesh.now + 20.0, lambda: rehearsal.watch.holder == node.name)
print(rehearsal.watch.holder, rehearsal.mesh.now, node.agent.history())
"""


def said(python: Path | str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run it away from the checkout's own packages."""
    return subprocess.run(
        [str(python), "-P", *words], capture_output=True, text=True, check=True, cwd=ROOT
    )


@pytest.fixture(scope="module")
def compiled() -> Path:
    """A Python that has what is here, compiled as far as it ever is."""
    if not COMPILED.exists():
        pytest.skip("nothing is compiled here: make compiled")
    site = Path(said(COMPILED, "-c", WHERE).stdout.strip()).parent
    for name, path in package_files():
        if not (site / name).exists() or (site / name).read_bytes() != path.read_bytes():
            pytest.skip(f"compiled before {name} was changed: make compiled")
    return COMPILED


CROWD = """
world = "sc4"
start = [3.4, 0.6, 90]
goal = [7.4, 0.7, -90]
plan = "rooms"
moving = [
  { kind = "person", at = [7.5, 2.2], speed = 0.8 },
  { kind = "person", at = [3.0, 3.8], heeds = false },
  { kind = "box", at = [8.3, 3.9], times = [10, 30] },
]
"""


@pytest.mark.parametrize(
    "words",
    [
        ("sc4", "sc1", "house"),
        ("sc3", "--parameters", "thesis"),
        ("crowd.toml", "offices", "--sensors", "real"),
    ],
)
def test_compiled_and_interpreted_publish_the_same(
    compiled: Path, words: tuple[str, ...], tmp_path: Path
) -> None:
    (tmp_path / "crowd.toml").write_text(CROWD)
    words = tuple(str(tmp_path / word) if word.endswith(".toml") else word for word in words)
    module = ("-m", "armadico_tools.fingerprint", *words)
    one, other = said(sys.executable, *module), said(compiled, *module)
    assert "pure Python" in one.stderr
    assert "compiled" in other.stderr
    assert one.stdout == other.stdout


def test_what_other_people_write_in_python_derives_from_what_is_compiled(
    compiled: Path, tmp_path: Path
) -> None:
    source = files("docs/tutorial.md")["wall-follower/wall_follower.py"]
    (tmp_path / "wall_follower.py").write_text(source)
    one, other = (said(who, "-c", NEWCOMER, str(tmp_path)) for who in (sys.executable, compiled))
    assert one.stdout.startswith("wall-follower ")
    assert one.stdout == other.stdout


@pytest.mark.parametrize("words", [("faults", "--seeds", "1"), ("model-check", "--faults", "0")])
def test_what_looks_inside_says_that_it_cannot(compiled: Path, words: tuple[str, ...]) -> None:
    done = subprocess.run(
        [str(compiled), "-P", "-m", "armadico", *words],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )
    assert done.returncode == 1
    assert "looks into what is compiled here" in done.stderr
    assert "Traceback" not in done.stderr
