"""Identification: exact where there is no noise, honest where there is, and refused by name."""

from __future__ import annotations

import json
import pickle
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean

import numpy as np
import pytest

from armadico.bridge.p2os.profile import P2osRobot
from armadico.cli import main
from armadico_tools.experiments import identify
from armadico_tools.experiments.identify import (
    MENDED,
    STRAIGHT,
    TURNING,
    Trial,
    prbs,
    profile,
    record,
)
from armadico_tools.experiments.runner import Context
from armadico_tools.identification import (
    ANGULAR,
    LINEAR,
    Estimate,
    Interval,
    Motion,
    NotIdentifiableError,
    autocorrelation,
    instrumental,
    least_squares,
    physical,
    response,
    truth,
)
from armadico_tools.speed_log import Floats, Log, LogError, read_log, write_log

ROBOT = profile()
TRUE = truth(ROBOT)
THETA = {LINEAR: np.array([0.06, 4.4, 0.55]), ANGULAR: np.array([2.3, 5.7, 3.6])}


def volts(rows: int, hold: int, low: float = 3.0, high: float = 9.0) -> Floats:
    bits = np.resize(np.repeat(prbs(5), hold), rows).astype(bool)
    return np.where(bits, high, low)


def modelled(
    motion: Motion, dt: float, seconds: float = 40.0, noise: float = 0.0, seed: int = 1
) -> Log:
    """A log of a robot that obeys (4.34) or (4.35) exactly, with THETA."""
    rows = round(seconds / dt)
    t, u, rest = np.arange(rows) * dt, volts(rows, round(0.4 / dt)), np.zeros(rows)
    left = u if motion == LINEAR else -u
    still = Log(t, left, u, rest, rest)
    exact = Estimate(motion, THETA[motion], np.eye(3), 0.0, 0, False)
    speed = response(still, ROBOT, exact)
    speed = speed + np.random.default_rng(seed).normal(size=rows) * noise
    return Log(t, left, u, *((speed, rest) if motion == LINEAR else (rest, speed)))


# Estimates ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", [least_squares, instrumental])
@pytest.mark.parametrize("dt", [0.02, 0.1])
@pytest.mark.parametrize("motion", [LINEAR, ANGULAR], ids=lambda motion: motion.name)
def test_without_noise_the_coefficients_are_exact_at_any_sampling(method, dt, motion) -> None:
    found = method(modelled(motion, dt), ROBOT, motion)
    assert found.theta == pytest.approx(THETA[motion], rel=1e-6)


def test_without_noise_the_simulated_robot_has_the_mass_and_friction_of_its_profile() -> None:
    log = record(STRAIGHT[1], 1, ROBOT, 20.0, noise_m_s=0.0)
    found = physical(instrumental(log, ROBOT, LINEAR), ROBOT)
    for name, it in found.items():
        assert it.value == pytest.approx(TRUE[name], rel=0.005), name


def test_the_caster_s_moment_is_in_the_turning_robot_s() -> None:
    log = record(MENDED[2], 1, ROBOT, 20.0, noise_m_s=0.0)
    found = physical(instrumental(log, ROBOT, ANGULAR, coupled=True), ROBOT)
    assert found["1/a22"].value == pytest.approx(TRUE["1/a22"], rel=0.01)


def estimates(trial: Trial, seeds: Sequence[int], **options: float) -> list[dict[str, Interval]]:
    return [
        physical(
            instrumental(
                record(trial, seed, ROBOT, **options), ROBOT, trial.motion, coupled=trial.coupled
            ),
            ROBOT,
        )
        for seed in seeds
    ]


@pytest.mark.parametrize("trial", [STRAIGHT[0], MENDED[1]], ids=lambda trial: trial.name)
def test_the_intervals_hold_the_true_values(trial: Trial) -> None:
    """17 of 20 is what an honest 95 % interval falls short of once in 65 times."""
    many = estimates(trial, range(20), seconds=30.0)
    for name in trial.motion.gives:
        assert sum(one[name].holds(TRUE[name]) for one in many) >= 17, name


def test_the_interval_is_no_wider_than_the_scatter() -> None:
    many = estimates(STRAIGHT[1], range(20), seconds=30.0)
    for name in LINEAR.gives:
        scatter = float(np.std([one[name].value for one in many], ddof=1))
        assert fmean(one[name].half for one in many) < 2.0 * 1.96 * scatter, name


def test_instruments_take_the_bias_away_that_noise_gives_least_squares() -> None:
    logs = [modelled(LINEAR, 0.1, noise=0.06, seed=seed) for seed in range(40)]
    off = [
        fmean(method(log, ROBOT, LINEAR).theta[2] for log in logs) - THETA[LINEAR][2]
        for method in (instrumental, least_squares)
    ]
    assert abs(off[0]) < 0.4 * abs(off[1])


@pytest.mark.parametrize("trial", [STRAIGHT[0], MENDED[0]], ids=lambda trial: trial.name)
def test_a_trial_that_went_to_another_process_is_driven_and_estimated_alike(trial: Trial) -> None:
    sent = pickle.loads(pickle.dumps(trial))
    here, there = (record(one, 1, ROBOT, seconds=10.0) for one in (trial, sent))
    assert np.array_equal(here.left_v, there.left_v)
    assert np.array_equal(here.v, there.v)
    motions = ((here, trial.motion), (there, sent.motion))
    estimates = [
        least_squares(log, ROBOT, motion, coupled=trial.coupled) for log, motion in motions
    ]
    assert np.array_equal(estimates[0].theta, estimates[1].theta)


def test_the_equation_as_printed_takes_the_coupling_for_friction() -> None:
    """With V2 = -V3 the robot also drives; C_v1 comes out hundreds of times too large."""
    (printed,) = estimates(TURNING[2], [1])
    assert printed["C_v1"].value > 100 * TRUE["C_v1"]
    assert not printed["C_v1"].holds(TRUE["C_v1"])


def test_the_casters_friction_does_not_differ_from_zero() -> None:
    for one in estimates(MENDED[1], range(3)):
        assert one["C_s1"].holds(0.0)
        assert one["C_s1"].half > 10 * TRUE["C_s1"]


def test_the_model_stops_where_friction_stops_it() -> None:
    t = np.arange(200) * 0.02
    u = np.where(t < 2.0, 6.0, 0.5)
    log = Log(t, u, u, np.zeros(200), np.zeros(200))
    model = response(log, ROBOT, Estimate(LINEAR, THETA[LINEAR], np.eye(3), 0.0, 0, False))
    assert model.max() > 0.5
    assert (model >= 0.0).all()
    assert model[-1] == 0.0


def test_autocorrelation_distinguishes_white_noise_from_drift() -> None:
    white = np.random.default_rng(1).normal(size=400)
    assert autocorrelation(white, 3)[0] == 1.0
    assert abs(autocorrelation(white, 3)[1]) < 0.2
    assert autocorrelation(np.cumsum(white), 3)[1] > 0.9


# Refusals -----------------------------------------------------------------------------------------


def constant(rows: int = 600) -> Log:
    speed = 0.5 + 0.01 * np.random.default_rng(1).normal(size=rows)
    return Log(np.arange(rows) * 0.05, *np.full((2, rows), 5.0), speed, np.zeros(rows))


def test_a_steady_drive_determines_nothing() -> None:
    with pytest.raises(NotIdentifiableError, match="hardly change") as caught:
        instrumental(constant(), ROBOT, LINEAR)
    assert caught.value.names == ("a11 (1/a11)", "a15 (C_v)", "a18 (C_s)")


def test_one_voltage_forward_and_backward_leaves_mass_and_coulomb_friction_one_unknown() -> None:
    """Force and friction's sign are in proportion then; C_v alone could be distinguished."""
    log = record(Trial("steps", LINEAR, "STEP", 8.0, 8.0), 1, ROBOT)
    with pytest.raises(NotIdentifiableError) as caught:
        least_squares(log, ROBOT, LINEAR)
    assert caught.value.names == ("a11 (1/a11)", "a18 (C_s)")


def test_driving_straight_does_not_determine_turning() -> None:
    with pytest.raises(NotIdentifiableError, match=r"a22 \(1/a22\), a26 \(C_v1\), a29 \(C_s1\)"):
        instrumental(record(STRAIGHT[0], 1, ROBOT, 10.0), ROBOT, ANGULAR)


ROWS = [f"{0.1 * n:.2f},5,5,0.{n % 7},0" for n in range(40)]


def text(rows: Sequence[str], header: str = "t,left_v,right_v,v,w") -> str:
    return "\n".join((header, *rows))


@pytest.mark.parametrize(
    ("log", "reason"),
    [
        ("", "empty"),
        (text(ROWS, "t,v,w"), "no column left_v, right_v"),
        (text(ROWS[:5]), "at least 20"),
        (text([*ROWS[:20], *ROWS[26:]]), r"line 22: a gap of 0.7 s at t = 1.900 s"),
        (text([*ROWS[:20], *ROWS[19:]]), "line 22: time does not go on"),
        (text([*ROWS[:20], "2.0,5,5,nan,0", *ROWS[21:]]), "line 22: v is not a number"),
        (text([*ROWS[:20], "2.0,5,five,0,0", *ROWS[21:]]), "line 22: could not convert"),
        (text([*ROWS[:20], "2.0,5", *ROWS[21:]]), "line 22: 2 columns"),
        (text([row.replace(",5,5,", ",,5,") for row in ROWS]), "left_v is empty: without"),
    ],
)
def test_a_bad_log_is_refused_with_the_place(log: str, reason: str) -> None:
    with pytest.raises(LogError, match=reason):
        read_log(log)


def test_a_log_survives_writing_and_reading_and_other_columns_are_let_be() -> None:
    log = record(STRAIGHT[0], 3, ROBOT, 2.0)
    lines = write_log(log).splitlines()
    again = read_log("\n".join(["note," + lines[0], *("x," + line for line in lines[1:])]))
    assert np.allclose(again.v, log.v, atol=1e-6)
    assert np.allclose(again.right_v, log.right_v, atol=1e-6)


# The experiment -----------------------------------------------------------------------------------


def shortly(
    trial: Trial,
    seed: int,
    robot: P2osRobot,
    seconds: float = 24.0,
    noise_m_s: float = identify.NOISE_M_S,
) -> Log:
    return record(trial, seed, robot, seconds, noise_m_s)


@pytest.mark.long
def test_the_experiment_shows_the_thesis_s_tables_beside_the_truth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(identify, "record", shortly)
    made = Context(out=tmp_path, runs=2, source="here")
    made.run(identify.IDENTIFY, "Identification")
    table = (tmp_path / "table.md").read_text()
    for number in ("17.83", "16.49", "0.2921", "0.4301", "0.000469", "17.07"):
        assert f"| {number} |" in table
    rows = (tmp_path / "estimates.csv").read_text().splitlines()
    assert len(rows) == 1 + len((*STRAIGHT, *TURNING)) * 2 * 2 * 3
    assert {"figure-4.8.png", "figure-4.9.png", "figure-4.10.png"} <= {f.name for f in made.files}


def test_table_4_6_is_reckoned_with_the_friction_found_straight_ahead(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(identify, "record", shortly)
    robot = identify.profile()
    trials = (*identify.STRAIGHT, *identify.MENDED)
    found = [one for trial in trials for one in identify.measure((trial, 1000))]
    alone = identify.pooled(found, identify.MENDED, 1000)
    whole = identify.together(found, 1000, robot)
    assert whole["C_s1"].half > alone["C_s1"].half
    share = 2.0 * robot.body.half_track_m / robot.body.wheel_radius_m
    moved = share * (whole["C_s"].value - robot.inertia.wheel_coulomb_nm)
    assert whole["C_s1"].value == pytest.approx(alone["C_s1"].value - moved)
    assert whole["I_0"].holds(robot.inertia.body_kg_m2)


def test_the_prbs_is_of_maximum_length_whatever_its_state() -> None:
    for state in range(127):
        bits = identify.prbs(state)
        windows = {tuple((bits + bits)[n : n + 7]) for n in range(127)}
        assert len(windows) == 127


def test_every_seed_has_its_own_noise_and_repeats() -> None:
    robot = identify.profile()
    logs = [identify.record(identify.STRAIGHT[0], seed, robot, 1.0) for seed in (1, 1, 2)]
    assert (logs[0].v == logs[1].v).all()
    assert (logs[0].v != logs[2].v).any()


def test_the_robot_that_is_held_turns_on_the_spot() -> None:
    robot = identify.profile()
    free, held = (
        identify.record(trial, 5, robot, 10.0, noise_m_s=0.0)
        for trial in (identify.TURNING[2], identify.MENDED[2])
    )
    assert abs(held.v).max() < 0.5 * abs(free.v).max()


# The command --------------------------------------------------------------------------------------


def test_simulated_logs_are_identified_from_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    straight, turning = str(tmp_path / "s.csv"), str(tmp_path / "t.csv")
    assert main(["identify", "--simulate", straight]) == 0
    assert main(["identify", "--simulate", turning, "--motion", "angular", "--seed", "3"]) == 0
    assert main(["identify", straight, turning, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["found"]
    found_parameters = {
        name: it for entry in found for name, it in entry.get("parameters", {}).items()
    }
    assert set(found_parameters) == set(TRUE)
    for name, it in found_parameters.items():
        assert abs(it["value"] - it["profile"]) < 2.0 * it["half_95"], name
    assert found_parameters["1/a11"]["told_from_zero"]
    assert not found_parameters["C_s1"]["told_from_zero"]


def test_the_table_marks_what_may_be_zero(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = str(tmp_path / "t.csv")
    assert main(["identify", "--simulate", log, "--motion", "angular"]) == 0
    assert main(["identify", log]) == 0
    rows = {line.split("│")[3].strip(): line for line in capsys.readouterr().out.splitlines()
            if line.startswith("│")}  # fmt: skip
    assert "may be 0" in rows["C_s1"]
    assert "may be 0" not in rows["1/a22"]


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ([], "name logs"),
        (["a.csv", "--simulate", "b.csv"], "name logs"),
        (["missing.csv"], "missing.csv: No such file"),
        (["--simulate", "a.csv", "--seed", "-1"], "at least 0"),
    ],
)
def test_wrong_use_is_one_line_and_exit_code_2(
    arguments: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["identify", *arguments]) == 2
    assert reason in capsys.readouterr().err


def test_a_log_without_excitation_fails_with_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "steady.csv"
    path.write_text(write_log(constant()))
    assert main(["identify", str(path)]) == 1
    assert "cannot identify a11 (1/a11), a15 (C_v), a18 (C_s)" in capsys.readouterr().err
