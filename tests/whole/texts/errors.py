"""Bad command lines and bad files, and what is printed for them: `errors.txt`.

Write the file again after a change of a text, and read the difference:

    .venv/bin/python -m tests.whole.texts.errors
"""

from __future__ import annotations

import os
import re
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout
from functools import partial
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

from armadico import cli
from armadico.cli.agent import main as agent
from armadico.config.errands import load_mission
from armadico.config.hosts import load_hosts
from armadico.config.places import Places
from armadico.config.profile import load_profile
from armadico.config.scenarios import load_scenario
from armadico.config.shipped import find
from armadico.config.worlds import load_world
from armadico.core.config_errors import ConfigError

FILE = Path(__file__).with_name("errors.txt")

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
armadico run sc1 --virtual --plot nowhere/picture.png
armadico run sc1 --virtual --dashboard
armadico run sc1 --virtual --page
armadico run sc1 --wait --runs 2
armadico run sc1 --rrd run.rrd
armadico run sc1 --virtual --record run.txt
armadico run sc1 --robot tcpp://here
armadico run sc1 --robot /dev/ttyUSB0
armadico run sc1 --robot serial:///dev/no-such-port
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
armadico run no-door.map --virtual --start 1 1 0 --goal 6 2 0
armadico run narrow.map --virtual --start 1 1 0 --goal 6 2 0
armadico run sc1 --virtual --without encoder
armadico run sc4 --virtual --without path-planning
armadico run sc1 --virtual --without interface
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
armadico ps --namespace nobody
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
armadico ps --connect tcp/127.0.0.1:1 --namespace nobody
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
armadico goto 1 2 nan
armadico goto 1 2e9
armadico goto 1 2 3 --timeout 0
armadico goto 1 2 --namespace nobody
armadico stop --timeout 0.5 --namespace nobody
armadico resume --confirm 12
armadico set goto v_max --namespace nobody
armadico top --once --namespace nobody
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
armadico localize home.map --world sc4 --map-from first
armadico up sc44
armadico up rouns
armadico up --hosts lab.toml --host lab1 --restarts -1
armadico up --hosts lab.toml --host lab1 --set goto=1
armadico up --hosts lab.toml --host lab1 --set goto.nope=1
armadico up --hosts lab.toml --host lab1 --set goto.v_max=fast
armadico up --hosts lab.toml --host lab1 --set avoid.v_max=1
armadico up --hosts lab.toml --host lab1 --with gotoo
armadico up --hosts lab.toml --host lab1 --without goto
armadico up --hosts lab.toml --host lab1 --robot tcp://127.0.0.1:8101
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
"""

# Files with one fault: what is replaced in a good text, and by what -------------------------------

SCENARIO = """\
world = "sc4"
start = [1, 1, 0]
goal = [8, 1, 0]
waypoints = [
  [1.5, 2, 90],
  [1.5, 3.6, 0],
]

plan = "rooms"
"""

SCENARIO_EDITS = [
    ('"sc4"', '"sc44"'),
    ('"sc4"', '"x.map"'),
    ("start = [1, 1, 0]", "start = [1, 0.1, 0]"),
    ("goal = [8, 1, 0]", "goal = [8, 0.3, 0]"),
    ("goal = [8, 1, 0]", "goal = [8, -1, 0]"),
    ("[1.5, 3.6, 0]", "[3, 3, 0]"),
    ("[1.5, 3.6, 0]", "[1.5, 3.6]"),
    ('"rooms"', '"room"'),
    ("plan", "paln"),
    ("goal = [8, 1, 0]", "goal = [8, 1, 400]"),
    ("plan =", 'robot = "pioneer"\nplan ='),
    ("plan =", 'sensors = "reel"\nplan ='),
    ("plan =", 'agents = ["goto", "avoid", "goto"]\nplan ='),
    ('"rooms"', '"rooms"\n[[moving]]\nkind = "persn"\nat = [1, 2]'),
    (
        '"rooms"',
        '"rooms"\n[[moving]]\nkind = "box"\nat = [2, 2]\n[[moving]]\nkind = "person"\nat = [3, 3]',
    ),
    ('"rooms"', '"rooms"\n[[moving]]\nkind = "person"\nat = [30, 3]'),
    ('"rooms"', '"rooms"\n[[moving]]\nkind = "person"\nat = [1.4, 1]'),
    ('"rooms"', '"rooms"\n[[moving]]\nkind = "door"\nat = [1, 2]'),
    ('"rooms"', '"rooms"\n[[moving]]\nkind = "box"\nat = [-50, 3]'),
    ('"rooms"', '"rooms"\n[[moving]]\nkind = "door"\nwall = [2, 1, 2, 1]'),
    ('"rooms"', '"rooms"\n[[moving]]\nkind = "box"\nat = [2, 2]\ntimes = [9, 4]'),
    ('"rooms"', '"rooms"\n[[moving]]\nkind = "person"\nat = [2, 2]\nspeed = 9'),
    ('"rooms"', '"rooms"\n[[moving]]\nkind = "person"\nat = [2, 2]\npace = 1'),
    ('"rooms"', '"rooms"\n[[moving]]\nkind = "door"\nwall = [1, 2, 2, 2]\nradius = 0.3'),
    ('"rooms"', '"rooms"\n[[moving]]\nkind = "person"\nat = [2, 2]\ntimes = [4, 9]'),
    ('"rooms"', '"rooms"\n[[moving]]\nkind = "box"\nat = [2, 2]\nheeds = false'),
    ("plan =", "v_max = 0\nplan ="),
    ('"rooms"\n', '"rooms"\n[battery]\ncharge = 1.2\n'),
    ('"rooms"\n', '"rooms"\n[battery]\ncapacity_ah = 0\n'),
    ('"rooms"\n', '"rooms"\n[battery]\ncharg = 0.5\n'),
]

ALARMS = [
    ('mission = "surveillance"', "goal = [2.0, 5.0, 0.0]"),
    ('mission = "rouns"',),
    ('mission = "mine.toml"',),
    ("[[alarms]]", 'room = "R3"', "at_s = 5.0"),
    ("[[alarms]]", 'room = "R1"'),
    ("[[alarms]]", 'room = "R1"', "at_s = 5.0", 'within = "R2"'),
    ("[[alarms]]", 'rom = "R1"'),
]

MAP = """\
2D-Map
# walls of one room ; and a comment in a comment
LineMinPos: -500 0
LineMaxPos: 4000 3000
NumLines: 2
MapInfo: something of another program's
Cairn: RobotHome 500 600 90.000000 "" ICON "RobotHome 1"
Cairn: RobotHome 1 2 3 "" ICON "RobotHome 2"
Cairn: Goal 1000 2000 45.000000 "" ICON "over there"
Cairn: GoalWithHeading 1000 2000 -90.000000 "" ICON "table"   # and on
Cairn: ForbiddenLine 0 0 0.000000 "" ICON "" 0 0 1 1
Cairn: Dock 1000 1000 180.000000 "" ICON "by the wall"
Cairn: ArmadicoRoom 0 0 0.000000 "" ICON "A" 0 0 2000 3000
Cairn: ArmadicoRoom 0 0 0.000000 "" ICON "B" 2000 0 4000 3000
Cairn: ArmadicoDoor 2000 1500 0.000000 "A B" ICON "the door"
LINES
0 0 4000 0
2000 0 2000 1000.5
DATA
17 18
"""

MAP_EDITS = [
    ("2D-Map", "3D-Map"),
    ("0 0 4000 0", "0 0 4000"),
    ("0 0 4000 0", "0 0 4000 x"),
    ("0 0 4000 0", "0 0 4000 nan"),
    ("0 0 4000 0", "0 0 4000 99999999"),
    ("NumLines: 2", "NumLines: 3"),
    ("NumLines: 2", "NumLines:"),
    ("MapInfo:", "MapInfo"),
    ('RobotHome 500 600 90.000000 "" ICON "RobotHome 1"', "RobotHome 500 600 90"),
    ('Dock 1000 1000 180.000000 "" ICON "by the wall"', "Dock 1000 1000"),
    ("Dock 1000 1000", "Dock 1000 100"),
    ("Dock 1000 1000", "Dock 5000 1000"),
    ("ArmadicoRoom 0 0 0.000000", "ArmadicoRoom 0 0 9.0"),
    ('"A" 0 0 2000 3000', '"A" 2000 0 0 3000'),
    ('"A" 0 0 2000 3000', '"A"'),
    ("ArmadicoDoor", "ArmadicoDor"),
    ('"A B"', '"A"'),
    ('"A B"', '"a B"'),
    ("2000 1500", "1000 1500"),
]

HOSTS = """\
[robot]
router = "tcp/10.0.0.2:7447"
agents = ["robot", "encoder"]

[lab1]
address = "fe80::1"
agents = ["goto"]

[desk]
"""

HOSTS_EDITS = [
    ("router", "ruoter"),
    ('address = "fe80::1"', 'router = "tcp/[fe80::1]:7447"'),
    ("fe80::1", "fe80::g"),
    ("fe80::1", "tcp/lab1:7"),
    ('"tcp/10.0.0.2:7447"', "7447"),
    ('["goto"]', '"goto"'),
    ('["goto"]', '["a", "a"]'),
    ("[lab1]", "[robot]"),
    ("[robot]", "fleet = 'tcp/a:1'\n[robot]"),
    ("[robot]", "fleet = ['a:1']\n[robot]"),
    ("[robot]", "flet = []\n[robot]"),
    ("[lab1]", 'robot = "ttyUSB0"\n[lab1]'),
    ("[desk]", '[desk]\nrobot = "tcp://a:1"'),
    ('["goto"]', '["robot"]'),
    ("tcp/10.0.0.2:7447", "10.0.0.3:7447"),
    ("tcp/10.0.0.2:7447", "tcp/10.0.0.3"),
    ("tcp/10.0.0.2:7447", "tcp/10.0.0.3:"),
    ("tcp/10.0.0.2:7447", "tcp/a b:1"),
    ("tcp/10.0.0.2:7447", "tcp/-a:1"),
    ("tcp/10.0.0.2:7447", "tcp/:7447"),
    ("tcp/10.0.0.2:7447", "tcp/[::g]:7447"),
    ("tcp/10.0.0.2:7447", "tcp/fe80::1:7447"),
    ("tcp/10.0.0.2:7447", "tcp/10.0.0.3:0"),
    ("tcp/10.0.0.2:7447", "tcp/10.0.0.3:65536"),
    ("tcp/10.0.0.2:7447", "tpc/10.0.0.3:7447"),
    ("tcp/10.0.0.2:7447", "TCP/10.0.0.3:7447"),
    ("tcp/10.0.0.2:7447", "tcp/0.0.0.0:7447"),
    ("tcp/10.0.0.2:7447", "tcp/[::]:7447"),
]

PHOTO_OF = """
[procedures.photo-of]
takes = ["room"]
steps = [
  { do = "move", to = "$room" },
]
"""

MISSION_STEPS = [
    'do = "mve", to = "R1"',
    'do = "move", to = "R111"',
    'do = "move", too = "R1"',
    'do = "move"',
    'du = "move"',
    'do = "wait", seconds = "l"',
    'do = "wait", seconds = -1',
    'do = "take-photo", when = { batery_above = 0.2 }',
    'do = "take-photo", when = { room = "R3" }',
    'do = "take-photo", when = {}',
    'do = "photo-of", rom = "R1"',
    'do = "photo-of"',
    'do = "photo-of", room = "R4"',
    'do = "move", to = "$room"',
    'do = "move", to = "R1", else = [{ do = "wait", seconds = 1, else = [{ do = "wait" }] }]',
]
"""One step each, in a mission with that procedure."""

MISSIONS = [
    'steps = [\n  { do = "move", to = "" },\n]\n',
    'steps = [\n  { do = "in", room = 3 },\n]\n\n[procedures.in]\ntakes = ["room"]\n'
    'when = { room = "$room" }\nsteps = [{ do = "take-photo" }]\n',
    'steps = [\n  { do = "in", room = [1, 2] },\n]\n\n[procedures.in]\ntakes = ["room"]\n'
    'when = { room = "$room" }\nsteps = [{ do = "take-photo" }]\n',
    'steps = [{ do = "take-photo" }]\n[procedures.a]\nsteps = [{ do = "take-photo" }]\n'
    "[procedures.b]\nsteps = []",
    'steps = [{ do = "take-photo" }]\n[procedures.a]\nsteps = [{ do = "take-photo" }]\ngoal = 3',
    'steps = [{ do = "take-photo" }]\n[procedures."a.b"]\ngoal = 3',
    'on_alarm = "look"\nsteps = [{ do = "take-photo" }]\n[procedures.look]\n'
    'takes = [\'room\']\nsteps = [\n  { do = "move", to = "R111" },\n]',
    'on_alarm = "look"\nsteps = [{ do = "take-photo" }]\n[procedures.look]\n'
    'takes = [\'room\']\nsteps = [\n  { do = "move", to = "$rom" },\n]',
    'on_alarm = "look"\nsteps = [{ do = "take-photo" }]\n[procedures.look]\n'
    "takes = ['room', 's']\nsteps = [\n  { do = \"wait\", seconds = \"$s\" },\n]",
    'steps = [\n  { do = "a" },\n]\n\n[procedures.a]\nsteps = [\n  { do = "b" },\n]\n'
    '[procedures.b]\nsteps = [\n  { do = "a" },\n]\n',
    'steps = [\n  { do = "a" },\n]\n\n[procedures.a]\nsteps = [\n'
    '  { do = "take-photo", else = [{ do = "a" }] },\n]\n',
    'steps = [\n  { do = "take-photo" },\n]\n\n[procedures.move]\n'
    'steps = [{ do = "take-photo" }]\n',
    'on_alarm = "chek"',
    'on_alarm = "chek-alarm"\nsteps = [{ do = "take-photo" }]',
    'on_alarm = "wait"\nsteps = [{ do = "take-photo" }]',
    'priority = 2.0\nsteps = [{ do = "take-photo" }]',
    'energy = "chrge"\nsteps = [{ do = "take-photo" }]',
    "steps = []",
    'title = "x"',
    "steps = [",
]


# What is printed ----------------------------------------------------------------------------------


def commands() -> Iterator[str]:
    """Each command line with its exit code and the last lines of its standard error."""
    for line in COMMANDS.strip().splitlines():
        program, *words = shlex.split(line)
        out, err = StringIO(), StringIO()
        with redirect_stdout(out), redirect_stderr(err):
            try:
                code = agent(words) if program == "armadico-agent" else cli.main(words)
            except SystemExit as end:  # argparse
                code = int(str(end.code))
        yield f"$ {line}\n{err.getvalue()}exit {code}"


def scenarios() -> Iterator[str]:
    for old, new in SCENARIO_EDITS:
        yield _fault(SCENARIO, old, new, "own.toml", load_scenario)
    place = 'world = "surveillance"\nstart = [1.5, 2.0, 90.0]\n'
    for lines in ALARMS:
        text = "\n".join(lines)
        yield _fault(place, place, f"{place}{text}\n", "s.toml", load_scenario, shown=text)


def maps() -> Iterator[str]:
    for old, new in MAP_EDITS:
        yield _fault(MAP, old, new, "my.map", load_world)


def hosts() -> Iterator[str]:
    for old, new in HOSTS_EDITS:
        yield _fault(HOSTS, old, new, "hosts.toml", load_hosts)


def missions() -> Iterator[str]:
    places = Places(load_world("surveillance"), load_profile("pioneer-2dx").body)
    load = partial(load_mission, places=places, start=(1.5, 2.0))
    steps = [f"steps = [\n  {{ {row} }},\n]\n{PHOTO_OF}" for row in MISSION_STEPS]
    for text in (*steps, *MISSIONS):
        yield _fault(text, text, text, "m.toml", load, shown=text.removesuffix(PHOTO_OF).strip())


GROUPS: dict[str, Callable[[], Iterator[str]]] = {
    "command lines": commands,
    "scenarios": scenarios,
    "maps": maps,
    "host tables": hosts,
    "missions": missions,
}


def _fault(
    text: str,
    old: str,
    new: str,
    file: str,
    load: Callable[[Path], object],
    shown: str = "",
) -> str:
    assert old in text, old
    Path(file).write_text(text.replace(old, new, 1))
    try:
        load(Path(file))
    except ConfigError as error:
        found = f"{type(error).__name__}: {error}"
    else:
        found = "accepted"
    return f"{shown or f'{old} => {new}'}\n    {found}"


def written(group: str) -> str:
    """The section of `errors.txt` of one group, made anew."""
    with TemporaryDirectory(prefix="t-", dir="/tmp") as folder, chdir(folder):
        runtime = Path(folder, "run")
        runtime.mkdir(mode=0o700)
        for name, text in FILES.items():
            Path(name).write_bytes(text if isinstance(text, bytes) else text.encode())
        kept = {k: v for k, v in os.environ.items() if not k.startswith("ARMADICO_")}
        width = {"COLUMNS": "100", "XDG_RUNTIME_DIR": str(runtime)}
        with patch.dict(os.environ, kept | width, clear=True):
            cases = [case.replace(os.path.realpath(folder), "DIR") for case in GROUPS[group]()]
    configs = find("worlds", "sc1").parents[1]
    for path in (configs, configs.resolve()):
        cases = [case.replace(str(path), "CONFIGS") for case in cases]
    return "\n\n".join([f"# {group}", *cases]) + "\n"


def sections(text: str) -> dict[str, str]:
    """The sections of `errors.txt` by their groups."""
    parts = re.split(f"^(?=# (?:{'|'.join(GROUPS)})$)", text, flags=re.MULTILINE)
    return {
        part.partition("\n")[0].removeprefix("# "): part.rstrip("\n") + "\n"
        for part in parts
        if part
    }


def main(groups: Sequence[str]) -> None:
    """Write `errors.txt` again."""
    there = sections(FILE.read_text()) if FILE.exists() else {}
    made = there | {group: written(group) for group in groups or GROUPS}
    FILE.write_text("\n".join(made[group] for group in GROUPS if group in made))


if __name__ == "__main__":
    main(sys.argv[1:])
