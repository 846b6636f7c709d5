"""A live run on Zenoh, in which an agent was killed and another hung: every decision replayed."""

from __future__ import annotations

from pathlib import Path
from signal import SIGCONT, SIGKILL, SIGSTOP

import psutil
import pytest

pytest.importorskip("mcap")

from armadico.watch.recordings import Past
from armadico.watch.replay import replayed
from tests.programs import Start
from tests.robot.society import SOON, Observer
from tests.whole.live.test_run import run  # noqa: F401 - a fixture

pytestmark = pytest.mark.live


@pytest.mark.long
def test_all_decisions_of_all_agents_are_equal(
    run: Start,  # noqa: F811
    observer: Observer,
    tmp_path: Path,
) -> None:
    path = tmp_path / "run.mcap"
    words = ("--sensors", "ideal", "--goal", "1.5", "0", "0", "--no-plot", "--record", str(path))
    process = run("run", "sc1", *words)
    observer.until(observer.driving, "the robot is on its way")
    alive = dict(observer.client.alive)
    gone = observer.pid_of("path-planning", alive["path-planning"])
    hung = psutil.Process(observer.pid_of("sonar", alive["sonar"]))
    hung.send_signal(SIGSTOP)
    psutil.Process(gone).send_signal(SIGKILL)
    observer.cycles(8)
    hung.send_signal(SIGCONT)
    _, errors = process.communicate(timeout=2 * SOON)
    assert process.returncode == 0, errors
    outcomes = [replayed(journal) for journal in Past(path, pytest.fail).journals()]
    assert len(outcomes) == 8
    for outcome in outcomes:
        assert outcome.equal, outcome
        assert not outcome.end
        assert outcome.outputs > 10
