"""A robot that is a package of its own drives as ours do: docs/own-robot.md walks through it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.once import Once
from tests.programs import NO_PICTURE, SOON, call, starter

ROOT = Path(__file__).resolve().parents[3]

EXAMPLE = ROOT / "examples" / "create2"


@pytest.fixture
def env(once: Once, tmp_path: Path) -> dict[str, str]:
    """Where it is installed."""

    def install() -> str:
        copy = shutil.copytree(EXAMPLE, tmp_path / "create2")  # a build leaves folders behind
        quietly = ("--quiet", "--no-deps", "--no-build-isolation", "--no-index")
        words = ("-m", "pip", "install", *quietly, "--target", str(tmp_path / "site"), str(copy))
        subprocess.run([sys.executable, *words], check=True)
        return str(tmp_path / "site")

    return {**os.environ, "PYTHONPATH": once("create2", install)}


@pytest.mark.long
def test_its_own_tests_pass(env: dict[str, str]) -> None:
    words = ("-m", "pytest", "-q", "-n0", "-p", "no:cacheprovider", str(EXAMPLE))
    done = subprocess.run(
        [sys.executable, *words], env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout


@pytest.mark.long
def test_its_profile_is_found_by_its_name_and_reaches_the_goal_of_scenario_4(
    env: dict[str, str],
) -> None:
    words = ("run", "sc4", "--virtual", "--profile", "create2", "--sensors", "ideal")
    done = call(*words, env=env)
    assert done.returncode == 0, done.stderr
    assert "sc4: reached" in done.stdout


BLIND = """
import sys
from dataclasses import replace
import msgspec
from armadico_create2 import kind
from armadico.bridge.simulator.simulated import SimulatedRobot

class Blind(SimulatedRobot):
    def truth(self):
        return msgspec.structs.replace(super().truth(), collisions=0)

def blind(profile, stage, made=kind.CREATE2.simulated):
    robot = made(profile, stage)
    robot.__class__ = Blind
    return robot

kind.CREATE2 = replace(kind.CREATE2, simulated=blind)
from armadico.contracts.__main__ import main
sys.exit(main(["robot", "create2"]))
"""


def test_a_blind_variant_of_it_does_not_keep_the_contract(env: dict[str, str]) -> None:
    pytest.importorskip("armadico.contracts")
    done = subprocess.run(
        [sys.executable, "-c", BLIND], env=env, capture_output=True, text=True, check=False
    )
    judged = dict(line.split(maxsplit=1) for line in done.stdout.splitlines())
    assert done.returncode == 1, done.stderr
    assert "0 collisions are counted" in judged.pop("counts_a_collision")
    assert set(judged.values()) == {"yes"}


@pytest.mark.long
def test_the_robot_in_mujoco_keeps_the_contract(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    copy = shutil.copytree(ROOT / "examples" / "mujoco", tmp_path / "mujoco")
    quietly = ("--quiet", "--no-deps", "--no-build-isolation", "--no-index")
    words = ("-m", "pip", "install", *quietly, "--target", str(tmp_path / "site"), str(copy))
    subprocess.run([sys.executable, *words], check=True)
    there = {**os.environ, "PYTHONPATH": str(tmp_path / "site")}
    done = subprocess.run(
        [sys.executable, "-m", "armadico.contracts", "robot", "mujoco-bot"],
        env=there, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_collisions_of_a_driver_without_a_name_are_counted(env: dict[str, str]) -> None:
    words = ("--virtual", "--profile", "create2", "--sensors", "ideal", "--json")
    done = call("run", "sc1", "--goal", "0.6", "0", "0", *words, env=env)
    result = json.loads(done.stdout)
    assert (done.returncode, result["collisions"]) == (0, 0)
    assert result["judgement"] == {"answer": "yes", "reason": "", "cure": ""}


@pytest.mark.long
@pytest.mark.live
def test_live_it_is_driven_over_a_serial_line_and_its_collisions_are_counted(
    env: dict[str, str], tmp_path: Path
) -> None:
    line, namespace = str(tmp_path / "robot"), ("--namespace", f"create2-{os.getpid()}")
    with starter(env=env) as start:
        known = ("--id", "sim-create2")
        simulator = start("sim", "create2", "sc1", "--pty", line, *known, *namespace)
        assert simulator.stdout is not None
        assert "serial://" in simulator.stdout.readline()
        words = ("--robot", f"serial://{line}?baud=115200", "--profile", "create2", "--json")
        words += (*NO_PICTURE, "--simulator", "sim-create2")
        run = start("run", "sc1", "--goal", "0.6", "0", "0", *words, *namespace)
        out, errors = run.communicate(timeout=SOON)
        assert run.returncode == 0, errors
        result = json.loads(out)
        assert (result["reached"], result["collisions"]) == (True, 0)
