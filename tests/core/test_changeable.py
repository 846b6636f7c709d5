"""Parameters that are changed while their agent runs."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

import pytest
from msgspec import Meta, Struct

from armadico.core import parameters
from armadico.core.agent import Agent, Identity
from armadico.core.changeable import allowed
from armadico.core.discovery import AGENTS, agent_class, installed
from armadico.core.driver import Driver, Reply
from armadico.core.messages import (
    AgentSetting,
    Log,
    ParameterChange,
    ParametersReply,
    ParametersRequest,
    Setting,
    Tuning,
    encode,
)
from armadico.core.outgoing import Publish


class Table(Struct, frozen=True, forbid_unknown_fields=True):
    margin_m: Annotated[float, Meta(ge=0, le=1)] = 0.1


class Parameters(parameters.Parameters, frozen=True, kw_only=True):
    v_max: Annotated[float, Meta(gt=0, le=10)] | None = None
    tries: Annotated[int, Meta(ge=1, le=5)] = 2
    rules: Literal["safe", "thesis"] = "safe"
    loud: bool = False
    table: Table = Table()
    fixed: float = 1.0
    name: str = ""


class Toy(Agent):
    """Refuses three tries, for a reason of its own."""

    name = "toy"
    parameters = Parameters
    changeable: ClassVar = {
        "v_max": "m/s",
        "tries": "",
        "rules": "",
        "loud": "",
        "table.margin_m": "m",
    }
    p: Parameters

    def __init__(self, identity: Identity, given: Any = None) -> None:
        super().__init__(identity, given)
        self.seen: list[tuple[Any, Any]] = []

    def on_parameters(self, before: Any) -> None:
        if self.p.tries == 3:
            raise ValueError("three tries bring bad luck")
        self.seen.append((before, self.p))


KEY = "agent/toy/toy-1/parameters"


def toy(given: Parameters | None = None) -> tuple[Toy, Driver]:
    agent = Toy(Identity("toy-1"), given)
    driver = Driver(agent, 0.0, admit=False)
    driver.begin(0.0)
    driver.drain()
    return agent, driver


def query(driver: Driver, *change: tuple[str, str]) -> tuple[ParametersReply, list[Any]]:
    """The reply, and what is published with it."""
    request = ParametersRequest(tuple(Setting(*each) for each in change), "ann")
    driver.on_query(KEY, encode(request), "call", 1.0)
    outputs = driver.drain()
    (reply,) = (item for item in outputs if isinstance(item, Reply))
    assert (reply.call, reply.key) == ("call", KEY)
    assert isinstance(reply.message, ParametersReply)
    encode(reply.message)
    return reply.message, [item for item in outputs if isinstance(item, Publish)]


def test_a_query_returns_the_changeable_parameters_and_their_limits() -> None:
    _, driver = toy(Parameters(v_max=0.5))
    reply, outputs = query(driver)
    rows = {row.name: row for row in reply.parameters}
    assert list(rows) == list(Toy.changeable)
    v_max = rows["v_max"]
    assert (v_max.json, v_max.begun, v_max.unit) == ("0.5", "0.5", "m/s")
    assert (v_max.least, v_max.most, v_max.optional) == (0, 10, True)
    assert v_max.wanted == "a number above 0, at most 10 m/s, or none"
    assert rows["rules"].words == ("safe", "thesis")
    assert rows["loud"].wanted == "true or false"
    assert rows["tries"].wanted == "a whole number at least 1, at most 5"
    assert rows["table.margin_m"].json == "0.1"
    assert (reply.instance, reply.refusal, outputs) == ("toy-1", "", [])


def test_a_change_is_obeyed_published_and_logged() -> None:
    agent, driver = toy(Parameters(v_max=0.5))
    reply, outputs = query(driver, ("v_max", "0.25"), ("table.margin_m", "0.2"), ("tries", "2"))
    assert reply.refusal == ""
    assert {row.name: row.json for row in reply.parameters}["v_max"] == "0.25"
    assert {row.name: row.begun for row in reply.parameters}["v_max"] == "0.5"
    assert (agent.p.v_max, agent.p.table.margin_m, agent.p.fixed) == (0.25, 0.2, 1.0)
    ((before, after),) = agent.seen
    assert (before.v_max, after.v_max) == (0.5, 0.25)
    changes = [item for item in outputs if isinstance(item.message, ParameterChange)]
    assert [item.message for item in changes] == [
        ParameterChange("toy", "toy-1", "v_max", "0.5", "0.25", "ann"),
        ParameterChange("toy", "toy-1", "table.margin_m", "0.1", "0.2", "ann"),
    ]
    assert {item.key for item in changes} == {"agent/toy/toy-1/changed"}
    (line, _) = [item.message for item in outputs if isinstance(item.message, Log)]
    assert line.text == "v_max = 0.25, before 0.5: changed by ann"


def test_an_optional_one_is_cleared_and_a_word_a_truth_and_a_whole_number_are_set() -> None:
    agent, driver = toy(Parameters(v_max=0.5))
    changes = [("v_max", "null"), ("rules", '"thesis"'), ("loud", "true"), ("tries", "5")]
    assert query(driver, *changes)[0].refusal == ""
    assert agent.p == Parameters(rules="thesis", loud=True, tries=5)


@pytest.mark.parametrize(
    ("name", "value", "refusal"),
    [
        ("v_max", "20", "v_max = 20: expected a number above 0, at most 10 m/s, or none"),
        ("v_max", "NaN", "v_max = NaN: expected a number above 0, at most 10 m/s, or none"),
        ("v_max", '"fast"', 'v_max = "fast": expected a number'),
        ("v_max", "[" * 1000, "expected a number"),
        ("tries", "2.5", "tries = 2.5: expected a whole number at least 1, at most 5"),
        ("tries", "3", "three tries bring bad luck"),
        ("rules", '"unsafe"', 'rules = "unsafe": expected one of safe, thesis'),
        ("loud", "1", "loud = 1: expected true or false"),
        ("table.margin_m", "-0.1", "expected a number at least 0, at most 1 m"),
        ("v_mx", "1", "'v_mx'; did you mean 'v_max'"),
        (".", "1", "no parameter '.'"),
        ("fixed", "2", "fixed cannot be changed while the agent runs (can be changed: "),
        ("social.margin", "0", "social.margin cannot be changed while the agent runs"),
    ],
)
def test_what_is_wrong_is_refused_with_what_is_right_and_nothing_is_changed(
    name: str, value: str, refusal: str
) -> None:
    agent, driver = toy()
    reply, outputs = query(driver, ("loud", "true"), (name, value))
    assert refusal in reply.refusal
    assert outputs == []
    assert agent.p == Parameters()
    assert agent.seen == []
    assert len(reply.parameters) == len(Toy.changeable)


def tunings(outputs: list[Any]) -> list[Tuning]:
    return [item.message for item in outputs if isinstance(getattr(item, "message", None), Tuning)]


def remembered(*entries: tuple[str, str, str], counter: int = 1, by: int = 7) -> Tuning:
    rows = tuple(AgentSetting(agent, Setting(name, value)) for agent, name, value in entries)
    return Tuning(counter, by, rows)


def deliver(driver: Driver, outputs: Tuning, by: str = "toy-7") -> list[Any]:
    (to,) = (to for to in driver.agent.kernel.subscriptions if to.message is Tuning)
    driver.token(by.rpartition("-")[0], by, True, 2.0)
    driver.deliver(to, f"tuning/{by}", encode(outputs), 2.0)
    return driver.drain()


def test_an_agent_shares_its_own_settings_alone() -> None:
    _, driver = toy()
    deliver(driver, remembered(("other", "x", "1"), counter=4), "other-1")
    _, outputs = query(driver, ("v_max", "0.25"))
    assert [each.settings for each in tunings(outputs)] == [
        remembered(("toy", "v_max", "0.25")).settings
    ]


def test_settings_in_the_name_of_another_agent_are_refused() -> None:
    agent, driver = toy()
    deliver(driver, remembered(("toy", "v_max", "0.25")), "other-1")
    assert agent.p == Parameters()
    deliver(driver, remembered(("toy", "v_max", "0.25")))
    assert agent.p == Parameters(v_max=0.25)


def test_a_restarted_agent_gets_its_settings() -> None:
    """It receives them before it joins, or soon after."""
    for joined in (False, True):
        agent = Toy(Identity("toy-2"))
        driver = Driver(agent, 0.0, admit=False)
        if joined:
            driver.begin(0.0)
            driver.drain()
        outputs = deliver(driver, remembered(("toy", "v_max", "0.25")))
        if not joined:
            driver.begin(0.0)
            outputs = driver.drain()
        assert agent.p == Parameters(v_max=0.25)
        changes = [i.message for i in outputs if isinstance(getattr(i, "message", None), Log)]
        assert [line.text for line in changes] == [
            "v_max = 0.25, before null: changed by those who remember"
        ]
        assert tunings(outputs) == []


def test_settings_that_are_invalid_now_are_ignored_and_logged() -> None:
    """Set by an instance of another version, or by nonsense."""
    agent, driver = toy()
    outputs = deliver(
        driver, remembered(("toy", "v_max", "99"), ("toy", "gone", "1"), ("toy", "tries", "4"))
    )
    assert agent.p == Parameters(tries=4)
    lines = [i.message.text for i in outputs if isinstance(getattr(i, "message", None), Log)]
    assert len([line for line in lines if line.startswith("not set as before: ")]) == 2


def test_left_out_settings_are_added_again_and_that_ends() -> None:
    """Two instances are changed at once, and each publishes a list without the other's."""
    queue: list[tuple[str, Tuning]] = []
    drivers = {name: driven(Toy(Identity(name))) for name in ("toy-1", "toy-2")}
    for (name, driver), change in zip(
        drivers.items(), (Setting("v_max", "0.25"), Setting("tries", "4")), strict=True
    ):
        request = ParametersRequest((change,), "ann")
        driver.on_query(f"agent/toy/{name}/parameters", encode(request), "call", 1.0)
        queue += [(name, each) for each in tunings(driver.drain())]
    for _ in range(10):
        received, queue = queue, []
        for by, message in received:
            for name, driver in drivers.items():
                queue += [(name, each) for each in tunings(deliver(driver, message, by))]
    assert not queue, "it does not end"
    for driver in drivers.values():
        assert driver.agent.p == Parameters(v_max=0.25, tries=4)


def driven(agent: Toy) -> Driver:
    driver = Driver(agent, 0.0, admit=False)
    driver.begin(0.0)
    driver.drain()
    return driver


def test_an_agent_without_changeable_parameters_refuses() -> None:
    class Plain(Agent):
        name = "toy"

    driver = Driver(Plain(Identity("toy-1")), 0.0, admit=False)
    driver.begin(0.0)
    reply, _ = query(driver, ("x", "1"))
    assert reply == ParametersReply(
        "toy-1", (), "no parameter of this agent can be changed while it runs", fixed=()
    )


def test_a_reply_has_what_cannot_be_changed_and_is_no_default() -> None:
    launched = Parameters(social=parameters.Social(exchange="abrupt"))
    reply, _ = query(driven(Toy(Identity("toy-1"), launched)))
    assert [(row.name, row.json) for row in reply.fixed or ()] == [("social.exchange", '"abrupt"')]


def test_a_malformed_request_changes_nothing_and_is_no_failure() -> None:
    agent, driver = toy()
    for payload in (b"", b"\xff", b"\x82\x81\x81\x61x\x60"):
        driver.on_query(KEY, payload, "call", 1.0)
    assert not [item for item in driver.drain() if isinstance(item, Reply)]
    assert agent.p == Parameters()
    driver.on_query(KEY, b"\x80", "call", 1.0)  # an empty question is one for all that there are
    assert [item for item in driver.drain() if isinstance(item, Reply)]


@pytest.mark.parametrize("names", [{"v_mx": ""}, {"name": ""}, {"table": ""}])
def test_a_class_with_an_unchangeable_name_raises_at_once(
    names: dict[str, str],
) -> None:
    class Wrong(Toy):
        changeable: ClassVar = names

    with pytest.raises(ValueError, match=r"changeable: .*(v_mx|name|table)"):
        Wrong(Identity("toy-1"))


@pytest.mark.parametrize("name", installed(AGENTS))
def test_what_an_installed_agent_lets_be_changed_has_a_range_and_the_unit_of_its_name(
    name: str,
) -> None:
    kind = agent_class(name)
    units = {"_m": "m", "_s": "s", "_rad": "rad", "_m_s": "m/s"}
    for what, may in allowed(kind.parameters, kind.changeable).items():
        assert may.words or may.wanted == "true or false" or None not in (may.least, may.most)
        unit = kind.changeable[what]
        found = [unit_ for ending, unit_ in units.items() if what.endswith(ending)]
        assert unit in (found or ["", "m/s", "rad/s"])
