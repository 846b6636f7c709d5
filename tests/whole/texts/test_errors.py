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
    "no-door.map": CLOSED,
    "narrow.map": re.sub("Cairn: .*\n", "", CLOSED),
    "broken.map": "2D-Map\nLINES\n0 0 zero 0\nDATA\n",
    "home.map": "2D-Map\nLineMaxPos: 9000 9000\nLineMinPos: 0 0\n",
    "unclosed.toml": 'world = "sc1"\nstart = [0, 0\n',
    "colour.toml": START + 'colour = "red"\n',
    "twice.toml": START + 'agents = ["goto", "goto"]\n',
    "stranger.toml": START + 'agents = ["encoder",\n  "gotoo"]\n',
    "word.toml": START.replace("[1, 1, 0]", '[1, "east", 0]'),
    "nan.toml": START.replace("[1, 1, 0]", "[1, nan, 0]"),
    "wall.toml": START.replace('"sc1"', '"sc4"'),
    "blind.toml": 'world = "hall.map"\nstart = [1, 1, 0]\ngoal = [8, 1, 0]\n',
    "set-word.toml": '[goto]\nv_max = "fast"\n',
    "set-key.toml": "[goto]\n[goto.safety]\nfar = 1\n",
    "set-agent.toml": "[gotoo]\nv_max = 1\n",
    "bytes.toml": b"\xff\xff",
    "lab.toml": '[robot]\nrouter = "tcp/203.0.113.1:7447"\nagents = ["robot"]\n\n'
    '[lab1]\naddress = "127.0.0.21"\nagents = ["goto"]\n',
    "keys.toml": 'keys = "keys"\n[lab1]\nrouter = "tcp/127.0.0.1:1"\nagents = ["robot"]\n',
    "lab-gotoo.toml": '[lab1]\naddress = "127.0.0.21"\nagents = ["gotoo"]\n',
    "no-hosts.toml": "# empty\n",
    "number.toml": "lab1 = 3\n",
    "m.toml": 'title = "x"\nscenario = "huose"\nsteps = [{ do = "take-photo" }]\n',
    "nowhere.toml": 'title = "x"\nsteps = [{ do = "take-photo" }]\n',
    "no-ros.toml": JACKAL.replace("[ros2", "[ros"),
    "two-kinds.toml": PIONEER + "[ros2]\ncycle_s = 0.1\n",
    "array.toml": PIONEER.replace("[p2os]", "[[p2os]]"),
    "no-motor.toml": PIONEER.replace("[motor]", "[engine]"),
    "fast-odom.toml": JACKAL.replace("odom_hz = 50.0", "odom_hz = 5e3"),
    "battery.toml": JACKAL.replace("low_v = 23.4", "low_v = 40.0"),
    "firing.toml": SONARS.replace("[2, 1, 4, 0, 6, 3, 7, 5]", "[2, 1, 4, 0, 6, 3, 7, 8]"),
    "silent.toml": SONARS.replace("[2, 1, 4, 0, 6, 3, 7, 5]", "[2, 1, 4, 0, 6, 3, 7]"),
    "reach.toml": SONARS.replace("max_m = 5.0", "max_m = 0.05"),
    "frame.toml": SONARS.replace(', frame = "sonar_5"', ""),
    "tables.toml": SONARS.replace("[[ros2.sonar]]", '[[ros2.sonar]]\nname = "a"\n[[ros2.sonar]]'),
}

COMMANDS = """
armadico gto
armadico run
armadico run sc1 --world sc1
armadico run sc1 --sensor ideal
armadico run sc1 --set gto.v_max=1
armadico run sc1 --virtual --set goto.v_mx=1
armadico run sc11
armadico run missing.toml
armadico run --world hous --goal 1 1 0
armadico run away.map --for 2
armadico run sc1 --virtual --for 0
armadico run --world broken.map --goal 1 1 0
armadico run unclosed.toml
armadico run bytes.toml
armadico run colour.toml
armadico run twice.toml
armadico run stranger.toml
armadico run word.toml
armadico run nan.toml
armadico run wall.toml
armadico run --world home.map
armadico run --world home.map --for 1
armadico run sc1 --virtual --without gotho
armadico run sc1 --virtual --with goto --without goto
armadico run sc1 --virtual --sensors rael
armadico run sc1 --virtual --without robot
armadico run sc1 --virtual --controller fas
armadico run sc1 --virtual --parameters thesys
armadico run sc1 --virtual --parameters set-word.toml
armadico run sc1 --virtual --parameters set-key.toml
armadico run sc1 --virtual --parameters set-agent.toml
armadico run sc1 --virtual --runs 0
armadico run sc1 --virtual --seed -1
armadico run sc1 --virtual --goal 1 1 1e9
armadico run sc1 --virtual --start inf 1 0
armadico run sc1 --virtual --start -1e3 1 -0E0
armadico run sc1 --virtual --goal 99 1 0
armadico run sc4 --goal 4.6 1 0
armadico run sc4 --start 0.1 1 0
armadico run sc1 --virtual --robot tcp://127.0.0.1:1
armadico run sc1 --virtual --profile amigobo
armadico run sc1 --virtual --profile my.toml
armadico run sc1 --virtual --profile no-ros.toml
armadico run sc1 --virtual --profile two-kinds.toml
armadico run sc1 --virtual --profile array.toml
armadico run sc1 --virtual --profile no-motor.toml
armadico run sc1 --virtual --profile fast-odom.toml
armadico run sc1 --virtual --profile battery.toml
armadico run sc1 --virtual --profile firing.toml
armadico run sc1 --virtual --profile silent.toml
armadico run sc1 --virtual --profile reach.toml
armadico run sc1 --virtual --profile frame.toml
armadico run sc1 --virtual --profile tables.toml
armadico run sc1 --virtual --dashboard
armadico run sc1 --virtual --page
armadico run sc1 --wait --runs 2
armadico run sc1 --rrd run.rrd
armadico run sc1 --virtual --record run.txt
armadico run sc1 --robot tcpp://here
armadico run sc1 --robot /dev/ttyUSB0
armadico run sc1 --robot jackal
armadico run sc1 --namespace a*
armadico run sc1 --connect 7447
armadico run sc1 --connect tcp/127.0.0.1:7447
armadico run sc1 --attach --virtual
armadico run sc1 --attach --seed 1
armadico run sc1 --together goto+avoid --virtual
armadico run sc1 --together goto+nobody
armadico run sc1 --together goto
armadico run sc1 --virtual --robots 2
armadico run sc1 --virtual --replace
armadico run fleet --attach --namespace lab --robots=0
armadico run fleet --attach --namespace lab --with=mapping
armadico run fleet --attach --namespace lab --without=giveway
armadico run fleet --attach --namespace lab --seed=1
armadico run fleet --attach --namespace lab --plot=a.png
armadico run fleet --virtual --robots 11
armadico run fleet --virtual --replace
armadico run fleet --virtual --runs 3
armadico run fleet --virtual --namespace fleet
armadico sim sc99
armadico sim sc1 jackal --port 0
armadico sim jackal sc1 sc2 --port 0
armadico sim jackal sc1 --robot create3 --port 0
armadico sim jakal sc1 --port 0
armadico sim jackal --unkind --port 0
armadico sim sc1 --ros2
armadico sim sc1 --port 65536
armadico sim sc4 --port 0 --moving '[{"kind": "person"}]'
armadico sim sc4 --port 0 --moving '[{"kind": "person", "at": [100, 1]}]'
armadico sim sc4 --port 0 --moving 3
armadico sim sc4 --port 0 --charge 1.5
armadico sim sc4 --port 0 --capacity 0
armadico sim sc4 --port 0 --start 1e300 0 0
armadico sim sc4 --port 0 --start 4.6 1 0
armadico sim hall --port 0 --also lab/r2 x 1 0
armadico sim hall --port 0 --namespace lab/r1 --also lab/r1 3 3 0
armadico sim hall --port 0 --also lab/r2 1.5 1.6 0
armadico ps --hosts no-hosts.toml
armadico ps --hosts number.toml
armadico ps --hosts /dev/full
armadico ps --hosts labor
armadico ps --hosts missing.toml
armadico ps --namespace a*
armadico up --hosts lab.toml --host robot
armadico up --hosts lab.toml --connect tcp/10.0.0.9:7447
armadico ps --host lab1
armadico ps --hosts lab.toml --host lab
armadico ps --hosts lab.toml --connect tcp/10.0.0.9:7447
armadico-agent
armadico-agent encodr
armadico-agent encoder --set colour=1
armadico-agent encoder --set x=far
armadico-agent encoder --set x
armadico-agent encoder --config missing.toml
armadico-agent encoder sonar --config missing.toml
armadico-agent encoder sonar --set x=1
armadico-agent encoder --host lab1
armadico-agent goto --hosts lab.toml --host robot
armadico-agent goto --hosts lab.toml --host lab1
armadico keys
armadico keys inti
armadico keys init
armadico keys init --hosts lab.toml
armadico keys host lab9 --hosts keys.toml
armadico keys agent gotoo --hosts keys.toml
armadico keys person a/b --hosts keys.toml
armadico keys revoke goto --hosts keys.toml
armadico keys list --hosts keys.toml
armadico ps --hosts keys.toml
armadico goto 1 2 nan
armadico goto 1 2e9
armadico goto 1 2 3 --timeout 0
armadico resume --confirm 12
armadico set goto v_max --namespace nobody
armadico hz robot/state --json
armadico echo robot//state
armadico echo '**/**'
armadico logs -f --folder x
armadico logs --folder missing
armadico map save house.png
armadico new agent Wand
armadico new agent goto
armadico new agent class
armadico new agent mine --into missing
armadico page --bind 0.0.0.0 --token short
armadico dashboard --record run.mcap
armadico record run.txt
armadico export missing.mcap --to csv
armadico replay missing.mcap
armadico why
armadico why --live home.map
armadico why --live --at 3
armadico why home.map --at 3 --collision
armadico localize missing.npz
armadico mounting missing.npz
armadico mounting home.map
armadico mounting home.map --drift 2
armadico localize home.map --world sc4 --map-from first
armadico up sc44
armadico up rouns
armadico up --hosts lab.toml --open --host lab1 --restarts -1
armadico up --hosts lab.toml --open --host lab1 --set goto=1
armadico up --hosts lab.toml --open --host lab1 --set goto.nope=1
armadico up --hosts lab.toml --open --host lab1 --set goto.v_max=fast
armadico up --hosts lab.toml --open --host lab1 --set avoid.v_max=1
armadico up --hosts lab.toml --open --host lab1 --with gotoo
armadico up --hosts lab.toml --open --host lab1 --without goto
armadico up --hosts lab.toml --open --host lab1 --robot tcp://127.0.0.1:8101
armadico up --hosts lab-gotoo.toml --host lab1
armadico mission run surveilance --virtual
armadico mission run surveillance house --virtual
armadico mission run m.toml --virtual
armadico mission run nowhere.toml --virtual
armadico mission run missing.toml --virtual
armadico mission run surveillance --virtual --priority 2
armadico mission run surveillance --virtual --without mission-planing
armadico mission cancel
armadico mission cancel x --all
armadico explore
armadico explore sc3 --goal 1 1 0
armadico explore sc3 --virtual --within 2 0 1 1
armadico explore sc3 --virtual --within 0 0 1e7 1
armadico explore sc3 --virtual --within -1e5
armadico explore sc3 --virtual --within 0 0 1 inf
armadico explore sc3 --virtual --map a.png
armadico explore sc3 --virtual --runs 2 --map a.map
armadico explore sc3 --virtual --resume missing.yaml
armadico explore sc3 --attach --resume a.yaml
armadico explore sc3 --virtual --without encoder
armadico explore house --profile jackal --virtual --resume a.yaml
armadico map
armadico map load a.yaml
armadico map save a.png
armadico echo a//b
armadico echo 'robot/st*te'
armadico echo robot/state --namespace 'a*'
armadico echo robot/state -n 0
armadico record run.mcap --max-size 0
armadico record run.mcap --namespace a --namespace 'b*'
armadico completion tcsh
armadico localize home.map --noise -1
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
