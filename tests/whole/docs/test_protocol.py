"""The protocol page is enough for a program that has nothing of ours."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from armadico_tools.transcripts.__main__ import FOLDER
from armadico_tools.transcripts.replay import difference_of, inputs, read
from tests.whole.docs import contender
from tests.whole.docs.blocks import files
from tests.whole.docs.shell import Shell
from tests.whole.docs.watcher import watching

PAGE = "docs/protocol.md"
NAMESPACE = "protocol-test"
ROBOT = "armadico-agent encoder &\narmadico sim sc1 &\narmadico-agent robot &\n"


@pytest.mark.live
def test_the_program_on_the_page_hears_the_robot_and_stops_it(tmp_path: Path) -> None:
    with Shell(tmp_path, NAMESPACE) as shell, watching(shell) as watcher:
        shell.write(files(PAGE))
        assert shell.run(ROBOT).returncode == 0
        watcher.everybody({"encoder", "robot"})
        done = shell.run(f"python stranger.py {NAMESPACE} {shell.router}")
        assert done.returncode == 0, done.stdout
        assert "heading 0.00 rad" in done.stdout
        assert "stopped by stranger" in done.stdout
        assert shell.run("armadico resume").returncode == 0


# A contender by the rules of the page -------------------------------------------------------------

CONTENDER = Path(__file__).parent / "contender.py"
SCENES = [path for path in sorted(FOLDER.glob("*.jsonl")) if path.stem != "vectors"]
WHEELS_ONLY = [
    (path.stem, part.label)
    for path in SCENES
    for part in read(path.read_text(encoding="utf-8")).agents
    if part.competes_for == ("wheels",)
]


def test_the_check_on_the_page_is_a_pipe(tmp_path: Path) -> None:
    file, mine = str(FOLDER / "take-over.jsonl"), tmp_path / "mine.jsonl"
    tool = [sys.executable, "-m", "armadico_tools.transcripts"]
    given = subprocess.run([*tool, "inputs", file, "--agent", "b"], capture_output=True, check=True)
    said = subprocess.run(
        [sys.executable, str(CONTENDER), file, "b"],
        input=given.stdout,
        capture_output=True,
        check=True,
    )
    mine.write_bytes(said.stdout)
    compare = [*tool, "replay", file, "--agent", "b", "--said", str(mine)]
    done = subprocess.run(compare, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert "b publishes what take-over has" in done.stdout


@pytest.mark.parametrize(("name", "label"), WHEELS_ONLY)
def test_a_contender_by_the_rules_of_the_page_says_what_ours_says(name: str, label: str) -> None:
    text = (FOLDER / f"{name}.jsonl").read_text(encoding="utf-8")
    there, head = read(text), json.loads(text.splitlines()[0])
    part = next(p for p in head["agents"] if p["name"] == label)
    steps = part["bids"]["wheels"]
    said = contender.run(part["instance"], steps, inputs(there, label), head["ends"])
    assert difference_of(there, label, said) == ""
