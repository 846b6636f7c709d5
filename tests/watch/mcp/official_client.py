"""Twenty errands of a language model, as scripted calls through the official MCP Python client.

The client (package `mcp`, MIT) is no dependency of Armadico: it takes seconds to import and brings
some 25 packages. So this runs in an environment of its own, and starts Armadico as programs do:

    python -m venv mcp-client && mcp-client/bin/pip install mcp
    errands="mcp-client/bin/python tests/watch/mcp/official_client.py --armadico .venv/bin/armadico"
    $errands             # no policy
    $errands --policy

It starts a society of real processes with a simulated robot in the world `house`, which takes some
minutes, and prints a table in Markdown: what became of each errand, and what is right. The exit
code is 1 if one is wrong.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcp import Client, Implementation, StdioServerParameters

POLICY = """
[default]
forbidden = ["goto", "mission"]

[clients.errands]
forbidden = ["mission"]
rooms = ["A", "C", "corridor"]
v_max = 0.4
approval_rooms = ["C"]
"""
DONE, REFUSED = "done", "refused"
WAIT_S = 120


@dataclass(frozen=True)
class Found:
    """The answer to a call."""

    values: dict[str, Any]
    failed: bool

    def refuses(self, why: str) -> bool:
        return self.failed and why in self.values["refused"]


class Model:
    """Calls tools; people answer beside it by commands."""

    def __init__(self, client: Client, command: str, limited: bool) -> None:
        self.client, self.command, self.limited = client, command, limited

    async def call(self, tool: str, **arguments: object) -> Found:
        result = await self.client.call_tool(tool, arguments)
        return Found(dict(result.structured_content or {}), bool(result.is_error))

    async def goes(self, *, wait_s: float = WAIT_S, **to: object) -> str:
        found = await self.call("goto", wait_s=wait_s, **to)
        return str(found.values.get("end", found.values.get("refused")))

    async def person(self, *words: str) -> str:
        """Run a command of a person."""
        process = await asyncio.create_subprocess_exec(
            self.command, *words, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        out, _ = await process.communicate()
        return out.decode()

    async def approved(self, choice: str, **to: object) -> str:
        """Go somewhere while a person answers the request, if it has to wait for one."""
        going = asyncio.ensure_future(self.goes(**to))
        while self.limited and not going.done():
            waiting = json.loads(await self.person("approve", "--json") or "[]")
            for each in waiting:
                await self.person("approve", choice, each["code"])
            await asyncio.wait([going], timeout=1.0)
        return await going


Errand = Callable[[Model], Awaitable[str]]


async def where(m: Model) -> str:
    return DONE if (await m.call("where")).values["room"] == "A" else "wrong room"


async def places(m: Model) -> str:
    return DONE if "corridor" in (await m.call("places")).values["text"] else "no places"


async def picture(m: Model) -> str:
    (content,) = (await m.client.read_resource("armadico://map")).contents
    return DONE if content.mime_type == "image/png" and content.blob else "no picture"


async def foretold(m: Model) -> str:
    found = await m.call("rehearse", place="A", samples=2)
    return DONE if found.values.get("answer") in ("yes", "no", "unknown") else str(found.values)


async def to_a(m: Model) -> str:
    return _reached(await m.goes(place="A"))


async def misspelt(m: Model) -> str:
    return _refused(await m.call("goto", place="coridor"), "did you mean 'corridor'")


async def into_a_wall(m: Model) -> str:
    return _refused(await m.call("goto", x=4.6, y=1.0), "")


async def off_the_world(m: Model) -> str:
    return _refused(await m.call("goto", x=40.0, y=1.0), "")


async def cancelled_under_way(m: Model) -> str:
    await m.goes(x=1.0, y=3.0, wait_s=0)
    await m.call("cancel")
    end = (await m.call("wait")).values.get("end")
    return DONE if end == "cancelled" else str(end)


async def cancelled_at_once(m: Model) -> str:
    """In most tries it is still being planned then."""
    going = asyncio.ensure_future(m.call("goto", x=1.0, y=3.0, wait_s=WAIT_S))
    await asyncio.sleep(0)
    cancel = await m.call("cancel")
    goal = await going
    ended = goal.failed or goal.values.get("end") == "cancelled"
    return DONE if ended and not cancel.failed else f"{goal.values}, {cancel.values}"


async def not_stopped(m: Model) -> str:
    return DONE if (await m.call("where")).values["stopped_by"] is None else "stopped"


async def replaced(m: Model) -> str:
    first = asyncio.ensure_future(m.goes(x=1.0, y=3.0))
    await asyncio.sleep(1.0)
    second = await m.goes(place="A")
    return DONE if (await first, second) == ("superseded", "reached") else f"{await first} {second}"


async def looks_and_waits(m: Model) -> str:
    looked = await m.goes(place="corridor")
    return _reached(await m.goes(place="A")) if looked == "reached" else looked


async def out_of_the_area(m: Model) -> str:
    found = await m.call("goto", place="E")
    if found.failed:
        return _refused(found, "the policy (errands)")
    return DONE if not (await m.call("cancel")).failed else "not cancelled"


async def with_a_yes(m: Model) -> str:
    return _reached(await m.approved("yes", place="C"))


async def with_a_no(m: Model) -> str:
    end = await m.approved("no", x=6.0, y=1.2)
    return REFUSED if "denied" in end else _reached(end)


async def mission(m: Model) -> str:
    why = "the policy (errands) forbids" if m.limited else "no mission planning agent"
    return _refused(await m.call("mission", name="rounds"), why)


async def stopped(m: Model) -> str:
    return DONE if (await m.call("stop", reason="a child")).values["stopped"] else "not stopped"


async def goes_on(m: Model) -> str:
    """Refused; a person releases the stop by the code that `resume` tells."""
    found = await m.call("goto", place="A")
    code = (await m.call("resume")).values["text"].partition("--confirm ")[2].strip("`")
    released = "free to move" in await m.person("resume", "--confirm", code)
    return _refused(found, "stopped") if released else "not released"


async def told(m: Model) -> str:
    events = (await m.call("history", lines=200, more=True)).values["events"]
    return DONE if any('"place":"coridor"' in each["what"] for each in events) else "not told"


def _reached(end: str) -> str:
    return DONE if end == "reached" else end


def _refused(found: Found, why: str) -> str:
    return REFUSED if found.refuses(why) else str(found.values)


ERRANDS: list[tuple[str, Errand, str, str]] = [
    ("Where are you?", where, DONE, DONE),
    ("Which places do you know?", places, DONE, DONE),
    ("Show me the map", picture, DONE, DONE),
    ("Would you get to A?", foretold, DONE, DONE),
    ("Go to A", to_a, DONE, DONE),
    ("Go to the coridor", misspelt, REFUSED, REFUSED),
    ("Go into the wall", into_a_wall, REFUSED, REFUSED),
    ("Go off the world", off_the_world, REFUSED, REFUSED),
    ("Go; no, do not", cancelled_under_way, DONE, DONE),
    ("Go; no, do not, at once", cancelled_at_once, DONE, DONE),
    ("Is it stopped now?", not_stopped, DONE, DONE),
    ("Go there; no, to A", replaced, DONE, DONE),
    ("See whether the corridor is free, then wait in A", looks_and_waits, DONE, DONE),
    ("Go to E, and come back", out_of_the_area, DONE, REFUSED),
    ("Go to C; a person is asked and says yes", with_a_yes, DONE, DONE),
    ("Go on in C; a person is asked and says no", with_a_no, DONE, REFUSED),
    ("Do the rounds", mission, REFUSED, REFUSED),
    ("Stop!", stopped, DONE, DONE),
    ("Go on, although it is stopped", goes_on, REFUSED, REFUSED),
    ("What did you do?", told, DONE, DONE),
]
"""What is asked for, how, and what is right without and with the policy."""


async def run(command: str, limited: bool) -> int:
    server = StdioServerParameters(
        command=command, args=["mcp", "--world", "house"], env=dict(os.environ)
    )
    info, wrong = Implementation(name="errands", version="1"), 0
    print("| errand | right | it was |\n| --- | --- | --- |", flush=True)
    async with Client(server, client_info=info) as client:
        model = Model(client, command, limited)
        for what, errand, free, under_policy in ERRANDS:
            right = under_policy if limited else free
            try:
                was = await errand(model)
            except Exception as error:  # the errands after it are still tried
                was = f"{error!r}"
            wrong += was != right
            print(
                f"| {what} | {right} | {was if was == right else f'**wrong**: {was}'} |", flush=True
            )
    print(f"\n{len(ERRANDS) - wrong} of {len(ERRANDS)} right", flush=True)
    return 1 if wrong else 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--armadico", default="armadico", help="the command (default: that in PATH)"
    )
    parser.add_argument("--policy", action="store_true", help="limit the client by a policy")
    args = parser.parse_args()
    command = str(Path(args.armadico).absolute()) if "/" in args.armadico else args.armadico
    os.environ["ARMADICO_NAMESPACE"] = "errands"
    with tempfile.TemporaryDirectory(prefix="errands-") as folder:
        (policy := Path(folder, "policy.toml")).write_text(POLICY)
        words = [command, "up", "house", "--with", "assistant"]
        words += [f"--set=assistant.policy={policy}"] if args.policy else []
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=folder) as society:
            assert society.stdout is not None
            try:
                while "is up" not in (line := society.stdout.readline()):
                    if not line:
                        print("the society did not start", file=sys.stderr)
                        return 1
                return asyncio.run(run(command, args.policy))
            finally:
                subprocess.run([command, "down"], stdout=subprocess.DEVNULL, check=False)
                society.terminate()


if __name__ == "__main__":
    sys.exit(main())
