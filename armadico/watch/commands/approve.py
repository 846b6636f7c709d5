"""Answer what programs want to do and may not without a person; check policies and logs."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Final, TypeVar

from armadico.cli import options
from armadico.cli.options import FailedError, UnknownError, UsageError
from armadico.cli.parsing import Command, argument, flag, group, option

if TYPE_CHECKING:
    from armadico.core.messages import Message
    from armadico.launch.client import Client
    from armadico.watch.assistant.policy.messages import Approval, Approvals

M = TypeVar("M", bound="Message")

FIND_S: Final = 3.0
"""The timeout for what waits, which is published each second."""

ANSWER_S: Final = 10.0
"""The timeout for the assistant agent's reply, which waits for what becomes of the request."""

SAMPLES: Final = 4

WITHIN_S: Final = 20.0
"""The longest that a rehearsal may take, s: the request does not wait for it."""

WHAT: Final = ("list", "show", "yes", "no", "always", "forget", "log", "check")

EXAMPLES: Final = """\
  armadico approve                            who waits for what, for how long
  armadico approve show 902ff418              all of it
  armadico approve yes 902ff418               once, this request alone
  armadico approve always 902ff418            also later goals of this client at this place
  armadico approve no 902ff418
  armadico approve forget mcp-claude          nothing is approved for always for this client
  armadico approve log requests.jsonl         was the log of requests changed or cut?
  armadico approve check policy.toml --world house    is a policy right?
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    what: str = argument("what to do (default: list)", nargs="?", default="list", choices=WHAT)
    which: str | None = argument(
        "show, yes, no, always: the code of the request; forget: the client; log, check: the file",
        nargs="?",
    )
    world: str | None = option("check: the map with the policy's rooms", metavar="MAP")
    json: bool = flag("print JSON")
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    if (not args.which) != (args.what == "list"):
        words = {"log": "a file", "check": "a file", "forget": "a client, as the policy names it"}
        what = words.get(args.what, "the code of a request")
        need = "takes no further word" if args.what == "list" else f"needs {what}"
        raise UsageError(f"{args.what} {need}")
    done: dict[str, Callable[[Options, str], int]] = {
        "list": _list,
        "show": _show,
        "log": _log,
        "check": _check,
    }
    return done.get(args.what, _answer)(args, args.which or "")


def _list(args: Options, _which: str) -> int:
    with args.mesh.client() as client:
        known = _known(client)
    if args.json:
        print(json.dumps([_plain(each) for each in known.waiting]))
        return 0
    for each in known.waiting:
        left = f"{each.left_s:3.0f} s left"
        print(options.shown(f"{each.code}  {left}  {_wants(each)}: {each.why}"))
    if not known.waiting:  # because nothing is allowed, or nothing is limited, perhaps
        print(options.shown(f"nothing waits; {known.policy or 'there is no policy'}"))
    return 0


def _show(args: Options, code: str) -> int:
    """Print all of a request, and what would happen, if rehearsals are installed."""
    from msgspec.structs import replace

    with args.mesh.client() as client:
        known, since = _known(client), monotonic()
        each = next((each for each in known.waiting if each.code == code), None)
        if each is None:
            raise FailedError(f"no request with the code {options.shown(code)} waits")
        forecast = _rehearsed(client, each)
        each = replace(each, left_s=max(each.left_s - (monotonic() - since), 0.0))
    if args.json:
        print(json.dumps(_plain(each) | {"forecast": forecast}))
        return 0
    print(options.shown(_wants(each)))
    print(options.shown(f"  arguments  {each.request.text}"))
    print(options.shown(f"  because    {each.why}"))
    if forecast:
        print(options.shown(f"  forecast   {forecast}"))
    print(
        f"  answer     within {each.left_s:.0f} s: armadico approve yes {code} (or no, or always)"
    )
    return 0


def _rehearsed(client: Client, each: Approval) -> str:
    """What a rehearsal says would happen, or why that is not known; "" if none is installed."""
    from armadico.core.config_errors import ConfigError
    from armadico.core.discovery import REHEARSALS, installed
    from armadico.mesh.topology import MeshError
    from armadico.runtime.errors import SocietyError

    found = installed(REHEARSALS).get("virtual")
    if found is None:
        return ""
    if each.goal:
        errand = {"goal": [*each.goal, None]}
    else:  # a mission, of which the assistant agent has checked the request
        errand = {"mission": json.loads(each.request.text)["name"]}
    try:
        answer = found.load()(client.mesh, errand, samples=SAMPLES, within_s=WITHIN_S)
    except (ConfigError, SocietyError, MeshError) as error:
        return f"unknown: {error}"  # a person decides nevertheless, and sees all else
    return f"{answer['answer']}: {answer['says']}"


def _answer(args: Options, code: str) -> int:
    from armadico.mesh.door import person
    from armadico.runtime.errors import AbsentError
    from armadico.watch.assistant.policy.messages import Answered, ApprovalAnswer, Choice

    with args.mesh.client() as client:
        answer = ApprovalAnswer(code[:128], Choice(args.what), person())
        reply = client.query(answer, ANSWER_S, patience=FIND_S)
    if not isinstance(reply, Answered):
        raise AbsentError("no assistant agent is alive", client.mesh.namespace)
    if reply.refusal:
        raise FailedError(options.shown(reply.refusal))
    print(json.dumps({"answer": reply.text}) if args.json else options.shown(reply.text))
    return 0


def _received(client: Client, kind: type[M]) -> M | None:
    """Return the newest message of a kind; None: none came in time."""
    client.listen(kind)
    return client.wait_for(lambda: client.latest(kind), FIND_S)


def _known(client: Client) -> Approvals:
    """Return what waits. Raises AbsentError if no assistant agent is alive."""
    from armadico.runtime.errors import AbsentError
    from armadico.watch.assistant.policy.messages import Approvals

    found = _received(client, Approvals)
    if found is None:
        raise AbsentError("no assistant agent is alive", client.mesh.namespace)
    return found


def _wants(each: Approval) -> str:
    to = f" to {each.place}" if each.place else f" {each.request.text}"
    return f"{each.request.asker} asks for {each.request.tool}{to}"


def _plain(each: Approval) -> dict[str, object]:
    return {
        "code": each.code,
        "by": each.request.by,
        "called": each.request.called,
        "tool": each.request.tool,
        "arguments": each.request.text,
        "why": each.why,
        "left_s": round(each.left_s, 1),
    }


def _log(args: Options, which: str) -> int:
    """Check a log by its own chain, and its end by what the society remembers."""
    from armadico.watch.assistant.policy.ledger import against, check, lines_of
    from armadico.watch.assistant.policy.messages import Ledger

    try:
        found = check(lines_of(Path(which)))
    except OSError as error:  # not 1: that says of a log that it was changed
        raise UsageError(f"{which}: {error.strerror}") from None
    if wrong := found.fault or found.gap:
        raise FailedError(f"{which}: {wrong}")
    ledger, why = None, "no agent of a society remembers its length"
    try:
        with args.mesh.client() as client:
            ledger = _received(client, Ledger)
    except FailedError as error:  # no society is up: what the log says of itself counts yet
        why = str(error)
    if ledger is None:
        raise UnknownError(
            f"{which}: the chain of its {found.entries} entries holds; whether it was cut at its"
            f" end is not known: {why}"
        )
    if fault := against(found, ledger.counter, ledger.head):
        raise FailedError(f"{which}: {fault}")
    whole = {"entries": found.entries, "head": found.head}
    print(json.dumps(whole) if args.json else f"{which}: whole, {found.entries} entries")
    return 0


def _check(args: Options, which: str) -> int:
    from armadico.config.shipped import find
    from armadico.watch.assistant.policy.policy import BY_SONARS, load

    policy = load(find("policies", which), options.world_of(args.world))
    if any(rules.keeps_off for rules in policy.all):  # which robot it is for is not known here
        options.report(f"note: if the robot has sonars: {BY_SONARS}")
    for rules in policy.all:
        section = rules.section
        said = {f: getattr(section, f) for f in section.__struct_fields__}
        limits = {key: value for key, value in said.items() if value is not None}
        if args.json:
            print(json.dumps({"client": rules.name, "limits": limits}))
        else:
            words = ", ".join(f"{key} {value}" for key, value in limits.items())
            print(options.shown(f"{rules.name}: {words or 'no limits'}"))
    return 0


main: Final = Command(
    "armadico approve",
    Options,
    run,
    "Answer requests of programs that wait for a person, as the policy asks; check a policy, and"
    " the log of requests.",
    EXAMPLES,
)
