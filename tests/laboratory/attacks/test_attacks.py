"""`armadico attacks`: an open society is at anybody's mercy, one with keys at nobody's."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from armadico.bridge.p2os.commands import Cmd, quantity
from armadico.cli.options import FAILED, UNKNOWN, UsageError
from armadico_tools.attacks import running
from armadico_tools.attacks.attempts import ATTEMPTS, Known
from armadico_tools.attacks.peer import Peer
from armadico_tools.attacks.running import TRIES, Outcome, link, linked
from armadico_tools.attacks.strangers import member, strangers
from armadico_tools.attacks.victim import Drive, Victim
from armadico_tools.commands import attacks
from tests.runtime_folder import fresh_folder


@pytest.fixture(autouse=True)
def apart(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", fresh_folder())
    monkeypatch.setenv("TMPDIR", str(tmp_path))


def test_list_names_every_attack(capsys: pytest.CaptureFixture[str]) -> None:
    assert attacks.main(["--list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(ATTEMPTS)


def test_the_page_has_a_row_for_each_attack() -> None:
    page = (Path(__file__).parents[3] / "docs" / "security.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([\w-]+)` \| (.*?) \|", page, re.MULTILINE)
    attempts = [(attempt.name, attempt.text) for attempt in ATTEMPTS.values()]
    assert rows[: len(attempts)] == attempts


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["stopp"], "did you mean 'stop'"),
        (["--as", "goto"], "--as needs --keys"),
        (["--keys", "--soak", "1", "--certificates", "35"], "at least 36"),
    ],
)
def test_wrong_words_are_refused(words: list[str], why: str) -> None:
    with pytest.raises((UsageError, SystemExit)) as refused:
        attacks.main(words)
    assert isinstance(refused.value, SystemExit) or why in str(refused.value)


def test_a_table_has_a_column_for_each_attacker(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    outcomes = (
        Outcome("sonar", False, "stop", True, ("stood 97%", "robot stopped")),
        Outcome("sonar", False, "goal", True),
        Outcome("mcp", False, "stop", False),
    )
    monkeypatch.setattr(running, "run", lambda *_, **__: iter(outcomes))
    assert attacks.main(["--keys", "--as", "sonar", "--as", "mcp", "--table"]) == UNKNOWN
    printed = capsys.readouterr()
    assert "stop: the attacker got no link, so nothing was tried" in printed.err
    assert printed.out.splitlines() == [
        "| attack | sonar | mcp |",
        "| --- | --- | --- |",
        "| `stop` | stood 97%; robot stopped | no link |",
        "| `goal` | - | not tried |",
    ]


@pytest.mark.parametrize(
    ("keys", "outcomes", "code"),
    [
        (True, [Outcome("a stranger", True, "stop", False)], 0),
        (True, [Outcome("a stranger", True, "stop", True)], FAILED),
        (False, [Outcome("a stranger", True, "stop", True, ("stood 97%",))], 0),
        (False, [Outcome("a stranger", True, "stop", False)], UNKNOWN),
        (True, [], UNKNOWN),
    ],
)
def test_an_attack_that_was_not_made_is_no_defence(
    keys: bool, outcomes: list[Outcome], code: int
) -> None:
    assert attacks.judged(outcomes, keys=keys).exit_code == code


def test_the_orders_on_the_line_are_in_effect_until_the_next() -> None:
    drive = Drive()
    drive.write(quantity(Cmd.VEL, 0.3), 1.0)
    drive.write(quantity(Cmd.RVEL, 0.0), 1.25)
    assert drive.between(0.9, 1.3) == [(0.0, 0.0), (0.3, 0.0), (0.3, 0.0), (0.3, 0.0)]
    assert drive.now() == (0.3, 0.0)


def test_a_forged_ballot_is_of_this_cycle() -> None:
    known = Known(cycle=[7, 41], ballot=[3, 0.5, False, "goto-1"])
    assert (known.ahead(1), known.term, known.holder) == ([7, 42], 3, "goto-1")
    assert known.beyond(2**52 - 1) == 0


@pytest.fixture
def closed() -> Iterator[Victim]:
    with Victim(keys=True) as victim:
        yield victim


@pytest.mark.live
@pytest.mark.long
def test_without_keys_a_stranger_releases_a_persons_stop() -> None:
    with Victim(keys=False) as victim, Peer(victim.namespace, victim.endpoint) as peer:
        effects = victim.attacked(ATTEMPTS["release"], peer, 3.0)
    assert any(effect.startswith("moved") for effect in effects), effects
    assert "stop released" in effects


@pytest.mark.live
@pytest.mark.long
def test_with_keys_no_stranger_gets_a_link_and_a_member_does_until_it_is_revoked(
    closed: Victim,
) -> None:
    goto = member(closed, "goto")
    assert linked(closed, goto, TRIES)
    assert not [who.name for who in strangers(closed) if linked(closed, who)]
    peer = link(closed, goto.endpoint, goto.settings)
    assert peer is not None, "a member gets no link"
    with peer:
        closed.call("", "armadico", "keys", "revoke", "goto", *closed.joining(""))
        assert closed.viewer.wait_for(lambda: not peer.is_linked, 40.0)
    assert not linked(closed, goto)


@pytest.mark.live
@pytest.mark.long
@pytest.mark.parametrize("name", ["release", "drive-as-holder"])
def test_with_keys_a_fallen_member_can_do_nothing_in_anothers_name(
    closed: Victim, name: str
) -> None:
    closed.known.me = "sonar"
    sonar = member(closed, "sonar")
    peer = link(closed, sonar.endpoint, sonar.settings)
    assert peer is not None, "a member gets no link"
    with peer:
        assert closed.attacked(ATTEMPTS[name], peer, 3.0) == []


@pytest.mark.live
@pytest.mark.long
def test_the_command_prints_each_attack_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert attacks.main(["stop", "--json", "--seconds", "2"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert (row["name"], row["linked"], row["who"]) == ("stop", True, "a stranger")
    assert "robot stopped" in row["effects"]
