"""A recording of a run is a log of a robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from armadico.agents.slam.logs import logs
from armadico.agents.slam.logs.logs import LogError
from armadico.config.scenarios import load_scenario
from armadico.core.messages import Cycle
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import Scan, Sonar

AT = (0.0, 0.0, 0.0)


def recorded(path: Path, robot: str) -> Path:
    """A recording of a few seconds of scenario 4."""
    pytest.importorskip("mcap")
    from armadico.watch.virtual_recording import Recorded

    options = Options(seed=11, limit=6.0)
    run = Rehearsal(prepared(load_scenario("sc4"), options, profile=robot), options)
    with Recorded(run.mesh, path, run.namespace):
        run.run()
    return path


@pytest.mark.long(but=("pioneer-2dx-Sonar",))
@pytest.mark.parametrize(("robot", "kind"), [("pioneer-2dx", Sonar), ("jackal", Scan)])
def test_a_recording_of_a_virtual_run_is_a_log(tmp_path: Path, robot: str, kind: type) -> None:
    path = recorded(tmp_path / "run.mcap", robot)
    log = logs.read(path)
    assert log.cycles
    assert (log.world, log.profile) == ("sc4", robot)
    assert isinstance(log.readings.message(0, Cycle(1, 1), AT, 1), kind)
    assert np.diff(log.times) == pytest.approx(0.1, abs=0.05)
    assert log.known.all()
    start = load_scenario("sc4").start
    assert log.where(0) == pytest.approx(start, abs=0.05)
    with pytest.raises(LogError, match=r"other.*robot1"):
        logs.read(path, namespace="other")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    half = logs.read(path)
    assert 0 < len(half) < len(log)
    assert half.notes


def test_a_recording_without_odometry_is_refused() -> None:
    pytest.importorskip("mcap")
    kept = Path(__file__).parents[1] / "recordings" / "sc4.mcap"  # journals alone
    with pytest.raises(LogError, match="odometry"):
        logs.read(kept)
