"""What the documents tell people to type works, or says why nobody tried."""

from __future__ import annotations

from pathlib import Path

import pytest

from armadico.config.scenarios import load_scenario
from armadico.core.config_errors import ConfigError
from tests.whole.docs.blocks import NOTES, Block, blocks, blocks_of, files
from tests.whole.docs.shell import Shell

COMMANDS = [block for block in blocks() if block.is_commands]
ALONE = [block for block in COMMANDS if not block.note]
BRIEF = 'scenario = "surveillance"\nsteps = [{ do = "take-photo" }]\n'


@pytest.mark.parametrize("block", ALONE, ids=str)
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


def test_commands_are_found_with_and_without_a_language() -> None:
    found = blocks_of(
        "```sh\na\n```\n\n```\narmadico ps\n```\n\n```\narmadico/  a folder\n```\n\n"
        "<!-- not run: x -->\n```sh\nb\n```"
    )
    assert [block.is_commands for block in found] == [True, True, False, True]
    assert [block.note for block in found] == ["", "", "", "not run"]
    assert [block.line for block in found] == [1, 5, 9, 14]


def test_the_tutorials_scenario_is_a_scenario(tmp_path: Path) -> None:
    path = tmp_path / "along.toml"
    text = files("docs/own-agent.md")["along.toml"]
    path.write_text(text)
    with pytest.raises(ConfigError, match="no agent 'wall-follower'"):
        load_scenario(path)  # the reader has installed it
    path.write_text(text.replace("wall-follower", "gothrough"))
    assert load_scenario(path).plan == "direct"
