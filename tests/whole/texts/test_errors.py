"""Whatever is wrong on a command line or in a file: exit code 2 and one line, no traceback."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from armadico import cli
from armadico.cli.agent import main as agent
from armadico.config.shipped import find

# The files that the command lines name -----------------------------------------------------------

CLOSED = """\
2D-Map
LineMinPos: 0 0
LineMaxPos: 8000 4000
NumLines: 5
Cairn: ArmadicoRoom 0 0 0 "" ICON "A" 0 0 4000 4000
Cairn: ArmadicoRoom 0 0 0 "" ICON "B" 4000 0 8000 4000
LINES
0 0 8000 0
8000 0 8000 4000
8000 4000 0 4000
0 4000 0 0
4000 0 4000 3600
DATA
"""
"""Two rooms and a passage too narrow for a robot, which is not a door."""

START = 'world = "sc1"\nstart = [0, 0, 0]\ngoal = [1, 1, 0]\n'

PIONEER = find("robots", "pioneer-2dx").read_text()
JACKAL = find("robots", "jackal").read_text()
SONARS = re.sub(
    r"\[\[ros2.sonar\]\].*", "[[ros2.sonar]]", find("robots", "jackal-sonars").read_text()
)

FILES = {
    "broken.map": "2D-Map\nLINES\n0 0 zero 0\nDATA\n",
    "home.map": "2D-Map\nLineMaxPos: 9000 9000\nLineMinPos: 0 0\n",
    "unclosed.toml": 'world = "sc1"\nstart = [0, 0\n',
    "stranger.toml": START + 'agents = ["encoder",\n  "gotoo"]\n',
    "nan.toml": START.replace("[1, 1, 0]", "[1, nan, 0]"),
    "wall.toml": START.replace('"sc1"', '"sc4"'),
    "set-word.toml": '[goto]\nv_max = "fast"\n',
    "bytes.toml": b"\xff\xff",
    "lab.toml": '[robot]\nrouter = "tcp/203.0.113.1:7447"\nagents = ["robot"]\n\n'
    '[lab1]\naddress = "127.0.0.21"\nagents = ["goto"]\n',
    "keys.toml": 'keys = "keys"\n[lab1]\nrouter = "tcp/127.0.0.1:1"\nagents = ["robot"]\n',
    "lab-gotoo.toml": '[lab1]\naddress = "127.0.0.21"\nagents = ["gotoo"]\n',
    "no-hosts.toml": "# empty\n",
    "m.toml": 'title = "x"\nscenario = "huose"\nsteps = [{ do = "take-photo" }]\n',
    "two-kinds.toml": PIONEER + "[ros2]\ncycle_s = 0.1\n",
    "no-motor.toml": PIONEER.replace("[motor]", "[engine]"),
    "firing.toml": SONARS.replace("[2, 1, 4, 0, 6, 3, 7, 5]", "[2, 1, 4, 0, 6, 3, 7, 8]"),
}

COMMANDS = """
armadico gto
armadico run
armadico run sc1 --world sc1
armadico run sc1 --sensor ideal
armadico run sc1 --virtual --set goto.v_mx=1
armadico run sc11
armadico run missing.toml
armadico run --world broken.map --goal 1 1 0
armadico run unclosed.toml
armadico run bytes.toml
armadico run stranger.toml
armadico run nan.toml
armadico run wall.toml
armadico run sc1 --virtual --without gotho
armadico run sc1 --virtual --parameters set-word.toml
armadico run sc1 --virtual --runs 0
armadico run sc1 --virtual --start inf 1 0
armadico run sc4 --goal 4.6 1 0
armadico run sc1 --virtual --profile two-kinds.toml
armadico run sc1 --virtual --profile no-motor.toml
armadico run sc1 --virtual --profile firing.toml
armadico run sc1 --virtual --dashboard
armadico run sc1 --virtual --record run.txt
armadico run sc1 --robot tcpp://here
armadico run sc1 --namespace a*
armadico run sc1 --connect 7447
armadico run sc1 --attach --virtual
armadico run sc1 --together goto+nobody
armadico run fleet --attach --namespace lab --robots=0
armadico run fleet --virtual --robots 11
armadico sim sc99
armadico sim jackal sc1 sc2 --port 0
armadico sim sc1 --port 65536
armadico sim sc4 --port 0 --moving '[{"kind": "person"}]'
armadico sim hall --port 0 --also lab/r2 1.5 1.6 0
armadico ps --hosts no-hosts.toml
armadico ps --hosts /dev/full
armadico up --hosts lab.toml --host robot
armadico ps --hosts lab.toml --host lab
armadico-agent
armadico-agent encodr
armadico-agent encoder --set x=far
armadico-agent encoder --config missing.toml
armadico-agent encoder sonar --set x=1
armadico-agent goto --hosts lab.toml --host robot
armadico keys inti
armadico keys init --hosts lab.toml
armadico keys agent gotoo --hosts keys.toml
armadico ps --hosts keys.toml
armadico goto 1 2 nan
armadico resume --confirm 12
armadico echo '**/**'
armadico logs --folder missing
armadico new agent class
armadico page --bind 0.0.0.0 --token short
armadico dashboard --record run.mcap
armadico replay missing.mcap
armadico why --live --at 3
armadico localize missing.npz
armadico mounting home.map --drift 2
armadico up --hosts lab.toml --open --host lab1 --restarts -1
armadico up --hosts lab.toml --open --host lab1 --set goto.v_max=fast
armadico up --hosts lab-gotoo.toml --host lab1
armadico mission run surveilance --virtual
armadico mission run m.toml --virtual
armadico mission cancel x --all
armadico explore sc3 --virtual --within 2 0 1 1
armadico explore sc3 --virtual --resume missing.yaml
armadico map save a.png
armadico record run.mcap --max-size 0
armadico completion tcsh
armadico set goto =0.4
"""


@pytest.mark.parametrize("line", COMMANDS.strip().splitlines())
def test_bad_input_is_one_line_and_exit_code_2(
    line: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        Path(name).write_bytes(text if isinstance(text, bytes) else text.encode())
    program, *words = shlex.split(line)
    try:
        code = agent(words) if program == "armadico-agent" else cli.main(words)
    except SystemExit as end:
        code = int(str(end.code))
    printed, said = capsys.readouterr()
    assert (code, printed) == (2, "")
    assert len(said.splitlines()) == 1, said
    assert re.match(rf"{program}( [a-z]+)?: ", said), said
