"""`armadico approve`: a person sees what waits and why, and what a rehearsal says of it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import nullcontext
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from armadico.cli.options import FailedError, UnknownError, UsageError
from armadico.core import discovery
from armadico.core.config_errors import ConfigError
from armadico.mesh.topology import MeshError
from armadico.runtime.errors import SocietyError
from armadico.watch.assistant.messages import AssistantRequest
from armadico.watch.assistant.policy.ledger import BEGIN, Entry, sealed
from armadico.watch.assistant.policy.messages import Approval, Approvals
from armadico.watch.assistant.policy.policy import BY_SONARS
from armadico.watch.commands import approve

GOAL = Approval(
    "ab12", AssistantRequest("goto", '{"x":5.5}', "m"), "(5.50, 3.00)", "C", 116.0, (5.5, 3.0)
)
MISSION = Approval("ab12", AssistantRequest("mission", '{"name":"rounds"}', "m"), "", "each", 116.0)


def shown(
    each: Approval, rehearse: Any, monkeypatch: pytest.MonkeyPatch, *, as_json: bool = True
) -> None:
    """Show a request while 20 s pass."""
    clock = count(0.0, 20.0)
    offer = SimpleNamespace(load=lambda: rehearse)
    monkeypatch.setattr(approve, "monotonic", lambda: next(clock))
    monkeypatch.setattr(approve, "_known", lambda _: Approvals((each,)))
    monkeypatch.setattr(discovery, "installed", lambda _: {"virtual": offer})
    mesh = SimpleNamespace(client=lambda: nullcontext(SimpleNamespace(mesh=None)))
    options: Any = SimpleNamespace(what="show", which="ab12", json=as_json, mesh=mesh)
    assert approve.run(options) == 0


@pytest.mark.parametrize(
    ("each", "errand"),
    [(GOAL, {"goal": [5.5, 3.0, None]}), (MISSION, {"mission": "rounds"})],
)
def test_the_forecast_is_of_what_is_asked_for_and_has_its_answer(
    each: Approval,
    errand: Mapping[str, object],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def rehearse(_: object, wanted: object, **__: object) -> dict[str, str]:
        assert wanted == errand
        return {"answer": "unknown", "says": "arrives in 3 of 4"}

    shown(each, rehearse, monkeypatch)
    found = json.loads(capsys.readouterr().out)
    assert found["forecast"] == "unknown: arrives in 3 of 4"
    assert found["left_s"] == 96.0, "the rehearsal took 20 s of them"


@pytest.mark.parametrize("kind", [ConfigError, SocietyError, MeshError])
def test_a_request_that_cannot_be_rehearsed_is_shown(
    kind: type[Exception], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def rehearse(*_: object, **__: object) -> None:
        raise kind("no map 'house' here")

    shown(GOAL, rehearse, monkeypatch, as_json=False)
    said = capsys.readouterr().out
    assert "unknown: no map 'house' here" in said
    assert "within 96 s: armadico approve yes ab12" in said


@pytest.mark.parametrize(
    ("policy", "said"),
    [
        ("the policy is limits.toml", "nothing waits; the policy is limits.toml"),
        ("the policy cannot be used, so nothing is allowed", "so nothing is allowed"),
        ("", "there is no policy"),
    ],
)
def test_that_nothing_waits_is_told_with_why(
    policy: str, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(approve, "_known", lambda _: Approvals(policy=policy))
    mesh = SimpleNamespace(client=lambda: nullcontext(None))
    options: Any = SimpleNamespace(what="list", which=None, json=False, mesh=mesh)
    assert approve.run(options) == 0
    assert said in capsys.readouterr().out


def test_a_log_is_checked_without_a_society_and_its_end_is_unknown(tmp_path: Path) -> None:
    """Otherwise that no society is up would have the exit code of a log that was changed."""
    (log := tmp_path / "requests.jsonl").write_bytes(
        msgspec.json.encode(sealed(Entry(1, "2026-11-30", "started", "assistant"), BEGIN)) + b"\n"
    )

    def client() -> None:
        raise FailedError("no robot agent; start one with `armadico up`")

    mesh = SimpleNamespace(client=client)
    options: Any = SimpleNamespace(what="log", which=str(log), json=False, mesh=mesh)
    with pytest.raises(UnknownError, match=r"the chain of its 1 entries holds.*no robot agent"):
        approve.run(options)
    log.write_bytes(log.read_bytes().replace(b"started", b"stopped"))
    with pytest.raises(FailedError, match="line 1"):
        approve.run(options)


def test_a_log_that_is_not_there_is_no_log_that_was_changed(tmp_path: Path) -> None:
    options: Any = SimpleNamespace(what="log", which=str(tmp_path / "no"), json=False, mesh=None)
    with pytest.raises(UsageError, match="No such file"):
        approve.run(options)


@pytest.mark.parametrize(("limit", "warned"), [("people_m = 0.5", True), ("v_max = 0.3", False)])
def test_the_check_of_a_policy_says_what_sonars_cannot_tell(
    limit: str, warned: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (path := tmp_path / "limits.toml").write_text(f"[default]\n{limit}\n")
    options: Any = SimpleNamespace(what="check", which=str(path), world="house", json=True)
    assert approve.run(options) == 0
    said = capsys.readouterr()
    assert (f"if the robot has sonars: {BY_SONARS}" in said.err) == warned
    assert json.loads(said.out)["client"] == "default", "what reads it is not disturbed"


@pytest.mark.parametrize("what", ["yes", "no", "show", "forget", "log", "check"])
def test_an_empty_word_is_no_code_and_no_file(what: str) -> None:
    options: Any = SimpleNamespace(what=what, which="", json=False)
    with pytest.raises(UsageError, match=f"{what} needs"):
        approve.run(options)
