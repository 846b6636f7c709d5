"""Rights are derived from what classes declare, with the line of each declaration."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import msgspec
import pytest

import armadico
from armadico.core.agent import Agent
from armadico.core.messages import Log, Message, Stop
from armadico.core.resources import WHEELS
from armadico.keys.derived import contradictions
from armadico.keys.rights import Does, Member, RightsError, Table, covers, instances, table
from armadico.mesh.door import PAGE
from armadico.observe.guests import Person, Viewer
from tests.keys.members import ANNA, LAB, everybody

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
    members = [Member(cls.name, {cls.name: cls}) for cls in classes]
    members += [Member(name, {cls.name: cls for cls in group}) for name, group in together.items()]
    return table([*members, Member(ANNA, {}, Person), Member("viewer", {}, Viewer)])


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


def test_a_right_names_the_file_and_line_of_its_declaration() -> None:
    right = of(Goto).why("goto", Does.PUT, "robot/cmd/goto-1f")
    assert right is not None
    assert right.because.what == "Goto.competes_for"
    line = Path(right.because.file).read_text(encoding="utf-8").splitlines()
    assert line[right.because.line - 1].strip() == "competes_for = (WHEELS,)"


def test_every_right_of_an_installed_class_names_a_line_with_its_declaration() -> None:
    above = Path(armadico.__file__).parents[1]
    for right in everybody().rights:
        because = right.because
        lines = (above / because.file).read_text(encoding="utf-8").splitlines()
        attribute = because.what.split(",")[0].rpartition(".")[2]
        said = lines[because.line - 1]
        assert attribute in said or because.what.startswith("every "), right


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
        table([Member("a", {"viewer": Goto}), Member("viewer", {}, Viewer)])
    with pytest.raises(RightsError, match="two identities"):
        table([Member("viewer", {}, Viewer), Member("viewer", {}, Viewer)])


def test_a_person_releases_and_a_viewer_only_reads() -> None:
    rights = everybody()
    assert rights.why(ANNA, Does.PUT, f"robot/stop/{ANNA}-1f")
    for identity in rights.speakers:
        releases = rights.why(identity, Does.PUT, f"robot/release/{identity}-1f") is not None
        assert releases == (identity in (ANNA, PAGE)), identity
    assert not rights.why(ANNA, Does.PUT, "robot/stop/goto-1f")
    assert {right.does for right in rights.of("viewer")} == {
        *(Does.SUBSCRIBE, Does.QUERY, Does.WATCH, Does.LOOK)
    }
    assert not [right for right in rights.of("mcp") if right.key == "mission/request"]
    assert rights.why(LAB, Does.REPLY, "wakeup/wakeup-1f")


def test_a_table_is_the_same_after_it_was_stored() -> None:
    rights = everybody()
    assert msgspec.json.decode(msgspec.json.encode(rights), type=Table) == rights


def test_a_table_that_contradicts_the_classes_is_told_by_identity() -> None:
    class Louder(Goto):
        name = "goto"
        provides: ClassVar[tuple[type[Message], ...]] = (Log, Stop)
        queries = ()
        owns = ()
        answers = ()

    now, before = of(Goto), of(GotoFast)
    found = "\n".join(contradictions(before, now))
    assert "goto has no rights: its key was made after the table" in found
    assert "goto-fast has rights, and is no member any more" in found
    assert "the agents that may bid critical differ" in found
    assert not [*contradictions(now, now)]
    more = table([Member("goto", {"goto": Louder})])
    less = table([Member("goto", {"goto": Idle})])
    assert "goto lacks" in "\n".join(contradictions(less, more))
    assert "that its class does not declare" in "\n".join(contradictions(more, less))


@pytest.mark.parametrize(
    "rule", ["a/goto-$*", "a/*", "a/**", "**", "**/c", "a/*/c", "a/$*-b", "*/goto-$*/c", "a/b"]
)
@pytest.mark.parametrize(
    "key",
    [
        *("a", "a/b", "a/goto-1", "a/goto-", "a/goto-1/c", "a/goto-$*", "a/goto-f$*", "a/*", "**"),
        *("a/**", "a/**/c", "a/x-b", "b/c", "c", "a/*/c", "a/$*-b", "a/goto-fast-1"),
    ],
)
def test_expressions_cover_as_zenohs_do(rule: str, key: str) -> None:
    assert covers(rule, key) == zenoh.KeyExpr(rule).includes(zenoh.KeyExpr(key))


def test_the_rules_of_zenoh_name_each_identity_and_deny_by_default() -> None:
    found = of(Goto, GotoFast).access_control("lab/r1", ["lab/r2"])
    assert found["default_permission"] == "deny"
    rules, policies = found["rules"], found["policies"]
    assert isinstance(rules, list)
    assert isinstance(policies, list)
    ids = [rule["id"] for rule in rules]
    assert len({*ids}) == len(ids)
    of_goto = next(p for p in policies if p["subjects"] == ["lab/r1/goto"])
    own = [rule for rule in rules if rule["id"] in of_goto["rules"]]
    denied = [key for rule in own if rule["permission"] == "deny" for key in rule["key_exprs"]]
    assert f"lab/r1/robot/cmd/{instances('goto-fast')}" in denied
    assert "lab/r2/robot" in [p["subjects"][0] for p in policies]
    assert not [p for p in policies if p["subjects"] == ["lab/r1/robot"]]
