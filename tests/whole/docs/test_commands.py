"""What the documents tell people to type works, or says why nobody tried."""

from __future__ import annotations

from pathlib import Path

import pytest

from armadico.config.scenarios import load_scenario
from armadico.core.config_errors import ConfigError
from tests.whole.docs.blocks import NOTES, Block, blocks, files
from tests.whole.docs.shell import Shell

COMMANDS = [block for block in blocks() if block.is_commands]
LONG = {
    *("docs/faults.md", "docs/fleet.md", "docs/lasers.md", "docs/localization.md", "docs/logs.md"),
    *("docs/maps.md", "docs/own-profile.md", "docs/rivals.md", "docs/robots.md", "docs/slam.md"),
    "docs/tutorial.md",
}
"""Whose commands take seconds of a core each, and which other tests run, too."""
ALONE = [
    pytest.param(block, marks=[pytest.mark.long] if block.document in LONG else [], id=str(block))
    for block in COMMANDS
    if not block.note
]
BRIEF = 'scenario = "surveillance"\nsteps = [{ do = "take-photo" }]\n'


@pytest.mark.parametrize("block", ALONE)
def test_a_block_of_commands_works_as_it_stands(block: Block, tmp_path: Path) -> None:
    with Shell(tmp_path, "docs-test") as shell:
        shell.write(files(block.document))
        shell.write({"my/scenario.toml": 'world = "sc1"\nstart = [0, 0, 0]\ngoal = [2, 0, 0]\n'})
        shell.write({"my/brief.toml": BRIEF})
        done = shell.run(block.text)
    assert done.returncode == 0, f"{block}\n{done.stdout}"


def test_whatever_is_not_run_has_a_reason() -> None:
    unknown = [f"{block}: {block.note}" for block in blocks() if block.note not in NOTES | {""}]
    assert not unknown
    silent = [str(block) for block in blocks() if block.note and not block.value.strip()]
    assert not silent


def test_the_tutorials_scenario_is_a_scenario(tmp_path: Path) -> None:
    path = tmp_path / "along.toml"
    text = files("docs/own-agent.md")["along.toml"]
    path.write_text(text)
    with pytest.raises(ConfigError, match="no agent 'wall-follower'"):
        load_scenario(path)  # the reader has installed it
    path.write_text(text.replace("wall-follower", "gothrough"))
    assert load_scenario(path).plan == "direct"
