"""The conditions stored with a result, so that it can be reproduced."""

from __future__ import annotations

import platform
import shutil
from importlib import import_module
from pathlib import Path
from typing import Any

from msgspec.structs import replace

import armadico
from armadico.config.scenarios import Scenario, load_scenario
from armadico.launch.society import Options, conditions
from armadico.observe.conditions import Conditions

SC1 = load_scenario("sc1")


def of(*, scenario: Scenario = SC1, **options: Any) -> Conditions:
    return conditions(scenario, Options(**options), "virtual")


def test_a_run_from_python_has_its_conditions() -> None:
    done = armadico.run("sc1", virtual=True, seed=3, goal=(1.0, 0.0, 0.0), parameters="thesis")
    found = done.measures.conditions
    assert found is not None
    assert (done.measures.seed, found.mode) == (3, "virtual")
    assert found.namespace is found.robot is None
    assert found.scenario["goal"] == (1.0, 0.0, 0.0)
    assert found.agents["goto"], "the set's settings"
    software = found.software
    assert software.python == platform.python_version()
    assert {"eclipse-zenoh", "cbor2", "msgspec", "numpy", "pymunk"} <= set(software.packages)
    assert "unknown" not in software.packages.values()
    assert software.version != "unknown"
    assert len(software.source) == 16


def test_hashes_differ_in_what_was_changed() -> None:
    one = of()
    assert one == of()
    moved = of(scenario=replace(SC1, goal=(1.0, 0.0, 0.0)))
    assert moved.scenario_hash != one.scenario_hash
    assert moved.world_hash == one.world_hash
    assert of(scenario=replace(SC1, world="sc2")).world_hash != one.world_hash
    assert of(scenario=replace(SC1, robot="amigobot")).profile_hash != one.profile_hash
    assert "avoid" not in of(without=("avoid",)).agents


def test_the_hash_of_a_world_does_not_depend_on_its_file(tmp_path: Path) -> None:
    shipped = Path(next(iter(import_module("armadico.configs").__path__))) / "worlds" / "sc1.map"
    copied = str(shutil.copy(shipped, tmp_path / "elsewhere.map"))
    there, here = of(scenario=replace(SC1, world=copied)), of()
    assert (there.world_hash, there.scenario_hash) == (here.world_hash, here.scenario_hash)
