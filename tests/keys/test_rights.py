"""Rights are derived from what classes declare, with the line of each declaration."""

from __future__ import annotations

from importlib.util import find_spec
from itertools import product
from pathlib import Path

import pytest

import armadico
from armadico.core.agent import Agent
from armadico.core.resources import WHEELS
from armadico.keys.commands.rights import explanation
from armadico.keys.derived import contradictions
from armadico.keys.deriving import RightsError, Subject, table
from armadico.keys.expressions import covers
from armadico.keys.rights import Does, Table
from armadico.mesh.door import PAGE
from armadico.observe.guests import Person, Viewer
from tests.keys.members import ANNA, ANNA_B, LAB, everybody

zenoh = pytest.importorskip("zenoh")


class Goto(Agent):
    name = "goto"
    competes_for = (WHEELS,)


class GotoFast(Agent):
    name = "goto-fast"
    competes_for = (WHEELS,)
    critical_for = (WHEELS,)


class Idle(Agent):
    name = "idle"


def of(*classes: type[Agent], **together: tuple[type[Agent], ...]) -> Table:
    members = [Subject(cls.name, {cls.name: cls}) for cls in classes]
    members += [Subject(name, {cls.name: cls for cls in group}) for name, group in together.items()]
    return table([*members, Subject(ANNA, {}, Person), Subject("viewer", {}, Viewer)])


def test_a_contender_commands_and_claims_for_its_own_instances_only() -> None:
    rights = of(Goto, GotoFast)
    for key in ("robot/cmd/{}", "resource/wheels/utility/{}"):
        assert rights.why("goto", Does.PUT, key.format("goto-1f"))
        assert not rights.why("goto", Does.PUT, key.format("goto-fast-1f"))
        assert rights.why("goto-fast", Does.PUT, key.format("goto-fast-1f"))
        assert not rights.why("goto-fast", Does.PUT, key.format("goto-1f"))
        assert not rights.why("goto", Does.PUT, key.format("*"))


def test_agents_of_one_process_have_the_rights_of_both() -> None:
    rights = of(both=(Goto, GotoFast))
    for instance in ("goto-1f", "goto-fast-1f"):
        assert rights.why("both", Does.PUT, f"robot/cmd/{instance}")
        assert rights.why("both", Does.TOKEN, f"agent/{rights.speaker(instance)}/{instance}")


def test_an_instance_belongs_to_the_longest_name() -> None:
    rights = of(Goto, GotoFast)
    assert rights.speaker("goto-1f") == "goto"
    assert rights.speaker("goto-fast-1f") == "goto-fast"
    assert rights.speaker("gotofast-1f") == ""
    assert rights.may_be_critical("goto-fast-1f", "wheels")
    assert not rights.may_be_critical("goto-1f", "wheels")
    assert not rights.may_be_critical("goto-fast-1f", "gripper")


def test_every_right_of_an_installed_class_names_a_line_with_its_declaration() -> None:
    above = Path(armadico.__file__).parents[1]
    for right in everybody().rights:
        because = right.because
        lines = (above / because.file).read_text(encoding="utf-8").splitlines()
        attribute = because.what.split(",")[0].rpartition(".")[2]
        said = lines[because.line - 1]
        assert attribute in said or because.what.startswith("every "), right


@pytest.mark.parametrize(
    ("key", "line"),
    [
        ("robot/cmd/goto-1f", "publishes robot/cmd/goto-$*: goto ("),
        ("robot/cmd/goto-slow-1f", "publishes robot/cmd/goto-$*: goto ("),
        ("robot/cmd/goto-fast-1f", "publishes robot/cmd/goto-fast-$*: goto-fast ("),
        (
            "robot/cmd/ghost-1f",
            "each publisher of Command has keys of its own, such as robot/cmd/goto-$*",
        ),
        (
            "robot/stop/ghost-1f",
            "each publisher of Stop has keys of its own, such as robot/stop/goto-$*",
        ),
        ("robot/state", "which no class of an identity has in its `provides`"),
        ("robot/nothing", "no installed message has this key"),
    ],
)
def test_a_key_is_explained_by_who_may_use_it_or_why_no_identity_may(key: str, line: str) -> None:
    found = [*explanation(of(Goto, GotoFast), f"robot1/{key}", "robot1")]
    assert any(line in each for each in found), found
    publishers = [each for each in found if each.startswith("publishes")]
    assert len(publishers) + found[-1].startswith("no identity publishes") == 1


def test_a_plug_in_without_declarations_is_named() -> None:
    assert of(Goto, Idle).silent == ("idle",)
    assert not everybody().silent


def test_only_the_classes_that_own_a_resource_may_own_it() -> None:
    rights = everybody()
    assert rights.may_own("robot-1f", "wheels")
    assert rights.may_own("interface-1f", "trajectory")
    for instance in ("goto-1f", "interface-1f", "stranger-1f", f"{ANNA}-1f"):
        assert not rights.may_own(instance, "wheels"), instance


def test_every_identity_may_query_the_tokens_that_it_may_watch() -> None:
    """A foreign program that only queries them would otherwise seem to be alone, and join."""
    rights = everybody()
    for identity in rights.speakers:
        watched = {right.key for right in rights.of(identity) if right.does is Does.WATCH}
        looked = {right.key for right in rights.of(identity) if right.does is Does.LOOK}
        assert watched == looked, identity


def test_names_that_cannot_be_told_apart_are_refused() -> None:
    with pytest.raises(RightsError, match="called 'viewer'"):
        table([Subject("a", {"viewer": Goto}), Subject("viewer", {}, Viewer)])
    with pytest.raises(RightsError, match="two identities"):
        table([Subject("viewer", {}, Viewer), Subject("viewer", {}, Viewer)])


def test_a_person_releases_and_a_viewer_only_reads() -> None:
    rights, people = everybody(), {ANNA, ANNA_B}
    if find_spec("armadico.watch"):
        people.add(PAGE)
    assert rights.why(ANNA, Does.PUT, f"robot/stop/{ANNA}-1f")
    for identity in rights.speakers:
        releases = rights.why(identity, Does.PUT, f"robot/release/{identity}-1f") is not None
        assert releases == (identity in people), identity
    assert not rights.why(ANNA, Does.PUT, "robot/stop/goto-1f")
    assert {right.does for right in rights.of("viewer")} == {
        *(Does.SUBSCRIBE, Does.QUERY, Does.WATCH, Does.LOOK)
    }
    assert not [right for right in rights.of("mcp") if right.key == "mission/request"]
    assert rights.why(LAB, Does.REPLY, "wakeup/wakeup-1f")


def test_a_table_that_contradicts_the_classes_is_told_by_identity() -> None:
    now, before = of(Goto), of(GotoFast)
    found = "\n".join(contradictions(before, now))
    assert "goto has no rights: its key was made after the table" in found
    assert "goto-fast has rights, and is no member any more" in found
    assert "the agents that may bid critical differ" in found
    assert not [*contradictions(now, now)]


RULES = ("a/goto-$*", "a/*", "a/**", "**", "**/c", "a/*/c", "a/$*-b", "*/goto-$*/c", "a/b")
KEYS = (
    *("a", "a/b", "a/goto-1", "a/goto-", "a/goto-1/c", "a/goto-$*", "a/goto-f$*", "a/*", "**"),
    *("a/**", "a/**/c", "a/x-b", "b/c", "c", "a/*/c", "a/$*-b", "a/goto-fast-1"),
)


def test_expressions_cover_as_zenohs_do() -> None:
    every = list(product(RULES, KEYS))
    ours = {(rule, key) for rule, key in every if covers(rule, key)}
    theirs = {(r, k) for r, k in every if zenoh.KeyExpr(r).includes(zenoh.KeyExpr(k))}
    assert ours == theirs
