"""Print messages published on matching keys."""

from __future__ import annotations

import json
import re
import sys
import time
from dataclasses import dataclass
from itertools import pairwise
from math import inf
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.parsing import BadValueError, Command, argument, flag, group, option

if TYPE_CHECKING:
    from armadico.observe.watching import Received, Watcher

HINT_S: Final = 3.0
"""After this time without a message a line is printed."""

EXAMPLES: Final = """\
  armadico echo robot/state
  armadico echo 'resource/*/utility/*' --json | jq .message.utility
  armadico echo 'robot/**' -n 20
  armadico echo '**' --timeout 5            give up after 5 s of silence
"""

_CHUNK: Final = re.compile(r"\*\*|\*|(?:[^*$#?\s]|\$\*)+")


def key_expression(text: str) -> str:
    """Check a key expression of Zenoh. Raises BadValueError."""
    chunks = text.split("/")
    if not all(_CHUNK.fullmatch(chunk) for chunk in chunks):
        raise BadValueError(
            f"{text!r} is not a key expression; expected parts between single slashes, none empty,"
            " * or ** alone in a part: robot/state, resource/*/utility/* or log/**"
        )
    if any(a == b == "**" for a, b in pairwise(chunks)):
        raise BadValueError(f"{text!r} is not a key expression: expected a single **")
    return text


def count(text: str) -> int:
    """A number from 1. Raises BadValueError."""
    if not text.isdecimal() or int(text) < 1:
        raise BadValueError(f"{text!r}: expected a number from 1")
    return int(text)


@dataclass(frozen=True, kw_only=True)
class Listening:
    """The options of a command that subscribes to keys."""

    pattern: str = argument(
        "the keys, such as robot/state or 'log/**'", metavar="KEYEXPR", read=key_expression
    )
    count: int | None = option(
        "end after N messages (default: never)", "-n", metavar="N", read=count
    )
    timeout: float | None = options.timeout_option("end after S seconds without a message")
    mesh: options.Mesh = group(options.Mesh, "the mesh")


@dataclass(frozen=True, kw_only=True)
class Options(Listening):
    json: bool = flag("print one JSON object a line")


def run(args: Options) -> int:
    mesh = args.mesh.join()
    from armadico.observe.watching import Watcher

    with mesh:
        watcher = Watcher([mesh])
        watcher.subscribe(args.pattern)
        for _ in range(args.count) if args.count else iter(int, 1):
            item = receive(watcher, args)
            print(options.shown(line_of(item, as_json=args.json)), flush=True)
    return 0


def receive(watcher: Watcher, args: Listening) -> Received:
    """The next message. Raises FailedError or AbsentError after `--timeout`."""
    from armadico.observe.watching import Received

    what = f"nothing is published on {args.pattern}"
    item = watcher.get(min(args.timeout or HINT_S, HINT_S))
    (mesh,) = watcher.meshes
    waited = args.timeout or inf
    if item is None and waited == inf:
        if mesh.wait_joined(0.0):  # otherwise the mesh reports the missing robot agent
            note = f"armadico: {what} (namespace {args.mesh.namespace!r}); waiting, Ctrl-C ends it"
            print(note, file=sys.stderr)
        while item is None:
            item = watcher.get(60.0)
    elif item is None:
        item = watcher.get(waited - HINT_S)
    if item is None:
        raise options.absent(mesh, waited, what)
    assert isinstance(item, Received), "the watcher subscribes to messages only"
    return item


def line_of(item: Received, *, as_json: bool) -> str:
    """A message as one line."""
    from armadico.core.messages import MessageError
    from armadico.observe.watching import as_object, read

    refused = ""
    try:
        message = read(item)
    except MessageError as error:
        message, refused = None, str(error)
    if as_json:
        found: dict[str, object] = {"t": item.at / 1e9, "key": item.key}
        found |= {"message": as_object(message)} if message else {"bytes": item.data.hex()}
        return json.dumps(found | ({"refused": refused} if refused else {}))
    clock = time.strftime("%H:%M:%S", time.localtime(item.at / 1e9))
    stamp = f"{clock}.{item.at // 1_000_000 % 1000:03d} {item.key}"
    if refused:
        return f"{stamp}  {refused}: {item.data.hex()}"
    if message is None:
        return f"{stamp}  {_unknown(item.data)}"
    return f"{stamp}  {type(message).__name__} {words(as_object(message))}"


def _unknown(data: bytes) -> str:
    """The fields of a message of another package, which is not in the table of services."""
    from armadico.core.messages import MessageError, plain_of

    try:
        found = words(plain_of(data))
    except MessageError:
        found = data.hex()
    return f"not in the table of services: {found}"


def words(value: object) -> str:
    """A message's fields as name=value, numbers to four digits."""
    if isinstance(value, dict):
        return " ".join(
            f"{name}=({words(found)})" if isinstance(found, dict) else f"{name}={words(found)}"
            for name, found in value.items()
        )
    if isinstance(value, list):
        inside = (f"({words(v)})" if isinstance(v, dict) else words(v) for v in value)
        return "[" + ", ".join(inside) + "]"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


main: Final = Command(
    "armadico echo",
    Options,
    run,
    "Print messages published on matching keys: * matches one part of a key, ** any number of"
    " parts. Unknown messages are printed as bytes.",
    EXAMPLES,
)
