"""`armadico get` and `set`: agents on a virtual mesh, and what people type."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from armadico import cli
from armadico.agents.driving.goto import Goto
from armadico.agents.interface.interface import Interface
from armadico.cli import options
from armadico.config.loading import set_values
from armadico.config.parameters import load_set, save
from armadico.core.config_errors import ConfigError
from armadico.core.driver import Driver
from armadico.core.messages import ParametersRequest, encode
from armadico.core.services import CARD, Service, service_of
from armadico.launch.virtual_session import VirtualSession
from armadico.mesh.virtual import VirtualMesh
from armadico.observe.findings import Demand, Hosts


class Crowd:
    """Goto, and whoever else a test wants."""

    def __init__(self) -> None:
        self.mesh = VirtualMesh(1)
        self.goto = self.add(Goto, 0)

    def add(self, kind: type[Goto | Interface], start: int) -> Goto | Interface:
        agent = kind(self.mesh.identity(kind.name, start))
        self.mesh.add(agent, admit=False)
        return agent


@pytest.fixture
def crowd(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Crowd:
    made = Crowd()
    monkeypatch.setattr(options.Mesh, "joined", lambda _args: VirtualSession(made.mesh))
    monkeypatch.chdir(tmp_path)
    return made


def test_a_value_is_changed_and_shown(crowd: Crowd, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["set", "goto", "v_max=0.4", "safety.margin_m=0.1"]) == 0
    instance = crowd.goto.instance
    assert capsys.readouterr().out.splitlines() == [
        f"{instance}: v_max = 0.4 m/s",
        f"{instance}: safety.margin_m = 0.1 m",
    ]
    assert crowd.goto.p == set_values(Goto.parameters(), ["v_max=0.4", "safety.margin_m=0.1"])
    assert cli.main(["get", "goto", "v_max"]) == 0
    assert capsys.readouterr().out == "0.4\n"
    assert cli.main(["set", "goto", "v_max=none"]) == 0
    assert cli.main(["get", "goto", "v_max"]) == 0
    assert capsys.readouterr().out.splitlines() == [f"{instance}: v_max = none", "none"]


def test_all_that_may_be_changed_is_a_table_and_json(
    crowd: Crowd, capsys: pytest.CaptureFixture[str]
) -> None:
    crowd.add(Interface, 0)
    assert cli.main(["set", "goto", "ahead_m=0.7"]) == 0
    capsys.readouterr()
    assert cli.main(["get"]) == 0
    table = capsys.readouterr().out.split()
    assert {"goto", "interface", "ahead_m", "0.7", "give_up_s", "120.0"} <= set(table)
    assert cli.main(["get", "--json"]) == 0
    rows = {(row["agent"], row["name"]): row for row in json.loads(capsys.readouterr().out)}
    ahead = rows["goto", "ahead_m"]
    assert (ahead["value"], ahead["begun"], ahead["unit"]) == (0.7, 0.6, "m")
    assert rows["goto", "v_max"]["value"] is None
    assert ("interface", "give_up_s") in rows


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (
            "goto v_max=20",
            1,
            "v_max = 20",
        ),
        ("goto v_mx=0.4", 1, "'v_max'"),
        (f"goto {'v' * 200}=1", 1, "ParametersRequest"),
        ("gto v_max=0.4", 1, "'goto'"),
        ("goto v_max", 2, "NAME=VALUE"),
    ],
)
def test_what_is_wrong_is_refused_in_one_line(
    crowd: Crowd, capsys: pytest.CaptureFixture[str], words: str, code: int, said: str
) -> None:
    assert cli.main(["set", *words.split(" ")]) == code
    printed = capsys.readouterr()
    assert said in printed.err
    assert printed.err.count("\n") == 1
    assert printed.out == ""
    assert crowd.goto.p == Goto.parameters()


@pytest.mark.parametrize("named", ["goto", "the second"])
def test_of_several_instances_all_follow(crowd: Crowd, named: str) -> None:
    second = crowd.add(Goto, 1)
    who = named if named == "goto" else second.instance[:10]
    assert cli.main(["set", who, "v_max=0.4"]) == 0
    crowd.mesh.run(crowd.mesh.now + 1.0)
    assert crowd.goto.p == second.p == set_values(Goto.parameters(), ["v_max=0.4"])


def test_an_agent_that_has_just_started_does_not_reply_for_another(
    crowd: Crowd, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its reply comes first, and its token was not seen yet."""
    query, kernel = VirtualSession.query, crowd.goto.kernel
    new = replace(kernel.tune(ParametersRequest(), 0.0), instance="new-1")

    def queried(session: VirtualSession, key: str, *args: Any) -> None:
        each = args[2]
        each(service_of(ParametersRequest).key_for(name="new", instance="new-1"), encode(new))
        query(session, key, *args)

    monkeypatch.setattr(VirtualSession, "query", queried)
    assert cli.main(["get", "goto", "v_max"]) == 0
    assert capsys.readouterr().out == "none\n"


def test_of_several_agents_one_has_to_be_named(
    crowd: Crowd, capsys: pytest.CaptureFixture[str]
) -> None:
    class Gothere(Goto):
        name = "gothere"

    crowd.add(Gothere, 0)
    assert cli.main(["set", "got", "v_max=0.4"]) == 1
    assert "'got' is the beginning of several: name one agent" in capsys.readouterr().err


def test_who_has_no_such_parameter_and_who_does_not_answer_are_told_apart(
    crowd: Crowd, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["get", "goto", "v_mx"]) == 1
    errors = capsys.readouterr().err
    assert all(word in errors for word in ("goto", "'v_mx'", "'v_max'"))
    next(n for n in crowd.mesh.nodes if n.agent is crowd.goto).hang()
    assert cli.main(["set", "goto", "v_max=0.4", "--timeout", "0.2"]) == 1
    assert f"{crowd.goto.instance} does not answer" in capsys.readouterr().err


# What is saved ------------------------------------------------------------------------------------


def test_what_is_saved_is_a_set_of_parameters(
    crowd: Crowd, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert cli.main(["set", "goto", "v_max=0.4", "--save"]) == 0
    assert "--parameters parameters.toml" in capsys.readouterr().out
    assert load_set(tmp_path / "parameters.toml") == {"goto": ("v_max=0.4",)}
    assert cli.main(["set", "goto", "v_max=20", "--save"]) == 1  # what is refused is not saved
    assert load_set(tmp_path / "parameters.toml") == {"goto": ("v_max=0.4",)}


def test_the_rest_of_a_set_stays_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("# mine\n[goto]  # slow\nv_max = 0.3\npark_m = 0.5\n\n[avoid]\nv_top = 0.2\n")
    save(path, "goto", {"v_max": 0.4, "safety.margin_m": 0.1})
    save(path, "avoid", {"v_top": None, "w_max": 1.0})
    save(path, "gothrough", {"v_max": 0.1})
    assert path.read_text() == (
        "# mine\n[goto]  # slow\nsafety.margin_m = 0.1\nv_max = 0.4\npark_m = 0.5\n\n"
        "[avoid]\nw_max = 1.0\n\n[gothrough]\nv_max = 0.1\n"
    )
    assert load_set(path)["goto"] == ("safety.margin_m=0.1", "v_max=0.4", "park_m=0.5")


@pytest.mark.parametrize(
    "text",
    [
        "[goto]\nsafety = { slow = 0.1 }\n",
        "[goto.safety]\nslow = 0.1\n",
        "goto = { v_max = 0.3 }\n",
        '[goto]\n"safety"."margin_m" = 0.2\n',
    ],
)
def test_where_there_is_no_place_for_it_the_file_stays_as_it_is(tmp_path: Path, text: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"goto\.safety\.margin_m"):
        save(path, "goto", {"safety.margin_m": 0.1})
    assert path.read_text() == text
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_one_and_the_file_keeps_who_may_read_it(tmp_path: Path) -> None:
    path, link = tmp_path / "mine.toml", tmp_path / "parameters.toml"
    path.write_text("[goto]\nv_max = 0.3\n")
    path.chmod(0o640)
    link.symlink_to(path.name)
    save(link, "goto", {"v_max": 0.4})
    assert link.is_symlink()
    assert path.read_text() == "[goto]\nv_max = 0.4\n"
    assert path.stat().st_mode & 0o777 == 0o640


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _folder(path: Path) -> None:
    path.mkdir()


def _read_only(path: Path) -> None:
    path.write_text("")
    path.chmod(0o400)


def _loop(path: Path) -> None:
    path.symlink_to(path.name)


def _nowhere(path: Path) -> None:
    path.symlink_to("there/is/none.toml")


def _identity(path: Path) -> tuple[int, int, int, int]:
    """Which file it is, its rights, size and last change; to follow a link alters its atime."""
    stat = path.lstat()
    return stat.st_ino, stat.st_mode, stat.st_size, stat.st_mtime_ns


@pytest.mark.parametrize("lay", [_pipe, _folder, _read_only, _loop, _nowhere])
def test_what_cannot_be_written_stays_as_it_is(
    lay: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "parameters.toml"
    lay(path)
    before = _identity(path)
    monkeypatch.setattr(os, "access", lambda *_: False)  # not even for who may do everything
    with pytest.raises(ConfigError, match=r"cannot be (read|written)"):
        save(path, "goto", {"v_max": 0.4})
    assert _identity(path) == before
    assert list(tmp_path.iterdir()) == [path]


def mute(crowd: Crowd, monkeypatch: pytest.MonkeyPatch, *services: Service) -> None:
    """Have goto receive no queries of some services."""
    answer, goto = Driver.on_query, crowd.goto.kernel
    keys = {each.key_for(name="goto", instance=crowd.goto.instance) for each in services}

    def on_query(self: Driver, key: str, *rest: Any) -> None:
        if self.kernel is not goto or key not in keys:
            answer(self, key, *rest)

    monkeypatch.setattr(Driver, "on_query", on_query)


@pytest.mark.parametrize("words", ["get", "get goto", "get goto v_max", "get --json", "graph"])
def test_what_an_agent_did_not_answer_is_unknown_and_not_left_out(
    crowd: Crowd,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    words: str,
) -> None:
    if words == "graph":
        pytest.importorskip("armadico.watch")
    crowd.add(Interface, 0)
    assert cli.main(words.split(" ")) == 0
    mute(crowd, monkeypatch, service_of(ParametersRequest), CARD)
    capsys.readouterr()
    assert cli.main(words.split(" ")) == options.UNKNOWN
    assert "of goto: unknown, no answer" in capsys.readouterr().err


@pytest.mark.parametrize("words", ["get", "graph"])
def test_agents_that_should_be_there_are_missing_in_an_answer_of_all(
    crowd: Crowd,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    words: str,
) -> None:
    if words == "graph":
        pytest.importorskip("armadico.watch")
    here = crowd.goto.identity.host

    def wanted(hosts: Hosts) -> int:
        monkeypatch.setattr(options.Mesh, "demand", lambda _: Demand(hosts))
        return cli.main([words])

    assert wanted({here: ("goto", "avoid")}) == options.UNKNOWN
    assert "of avoid: unknown" in capsys.readouterr().err
    assert cli.main(["get", "goto"]) == 0, "nothing else was asked"
    assert wanted({here: ("goto",), "lab": ("goto",)}) == options.UNKNOWN, "one of two is missing"
    assert "of goto: unknown" in capsys.readouterr().err
    assert wanted({here: ("goto",)}) == 0


def test_another_program_need_not_know_parameters(
    crowd: Crowd, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    crowd.add(Interface, 0)
    fill = crowd.goto.fill_card
    monkeypatch.setattr(crowd.goto, "fill_card", lambda card: replace(fill(card), version=""))
    mute(crowd, monkeypatch, service_of(ParametersRequest))
    assert cli.main(["get"]) == 0
    assert "unknown" not in capsys.readouterr().err
