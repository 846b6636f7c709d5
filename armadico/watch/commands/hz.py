"""Measure the rates of messages on matching keys."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Any, Final

from armadico.cli import options
from armadico.cli.parsing import Command, flag
from armadico.watch.commands.echo import Listening, receive

if TYPE_CHECKING:
    from armadico.observe.view import Rate
    from armadico.observe.watching import Watcher

SHOW_S: Final = 1.0

EXAMPLES: Final = """\
  armadico hz robot/state                 a line each second, until Ctrl-C
  armadico hz '**' -n 500 --json          every key, over 500 messages
  armadico hz encoder/pose -n 100
"""


@dataclass(frozen=True, kw_only=True)
class Options(Listening):
    json: bool = flag("with -n: print a JSON array")


def run(args: Options) -> int:
    if args.json and args.count is None:
        raise options.UsageError("--json needs -n N, the number of messages to measure")
    mesh = args.mesh.join()
    from armadico.observe.view import Rate
    from armadico.observe.watching import Watcher

    rates: dict[str, Rate] = {}
    with mesh:
        watcher = Watcher([mesh])
        watcher.subscribe(args.pattern)
        if args.count is None:
            _follow(watcher, args, rates)
        for _ in range(args.count or 0):
            item = receive(watcher, args)
            rates.setdefault(item.key, Rate()).add(item.at / 1e9)
        now = max(rate.last or 0.0 for rate in rates.values())
    if args.json:
        print(json.dumps([_row(key, rates[key], now) for key in sorted(rates)], indent=2))
    elif args.count is not None:
        _show(rates, now)
    return 0


def _follow(watcher: Watcher, args: Options, rates: dict[str, Rate]) -> None:
    """Show the rates each second, also while nothing arrives. Raises as `receive`."""
    from armadico.observe.view import Rate
    from armadico.observe.watching import Received

    item: object = receive(watcher, args)
    came_at = time.monotonic()
    show_at = came_at + SHOW_S
    while True:
        if isinstance(item, Received):
            rates.setdefault(item.key, Rate()).add(item.at / 1e9)
            came_at = time.monotonic()
        elif args.timeout is not None and time.monotonic() - came_at >= args.timeout:
            (mesh,) = watcher.meshes
            raise options.absent(mesh, args.timeout, f"nothing is published on {args.pattern}")
        if time.monotonic() >= show_at:
            show_at = time.monotonic() + SHOW_S
            _show(rates, watcher.clock() / 1e9)
        until = min(show_at, came_at + (args.timeout or inf))
        item = watcher.get(max(until - time.monotonic(), 0.0))


def _row(key: str, rate: Rate, now: float) -> dict[str, Any]:
    from armadico.core.services import service_at

    service, spread = service_at(key), rate.spread()
    return {
        "key": key,
        "messages": rate.count,
        "hz": rate.hz(now),
        "promised_hz": service.rate_hz if service else None,
        "least_s": spread and spread.least,
        "mean_s": spread and spread.mean,
        "most_s": spread and spread.most,
        "deviation_s": spread and spread.deviation,
    }


def _show(rates: dict[str, Rate], now: float) -> None:
    from armadico.observe.view import WINDOW_S

    for key in sorted(rates):
        row = _row(key, rates[key], now)
        ago = now - (rates[key].last or now)
        # Of a key with a low rate, such as battery/level, the window holds one message or none.
        if row["hz"] == 0.0 and ago > max(WINDOW_S, 2.0 / (row["promised_hz"] or inf)):
            total = f"{row['messages']} messages"
            print(f"{options.shown(key)}: 0 Hz, none for {ago:.0f} s; {total} before", flush=True)
            continue
        if row["hz"] is None or row["mean_s"] is None:
            print(f"{options.shown(key)}: {row['messages']} so far", flush=True)
            continue
        promised = "" if row["promised_hz"] is None else f" of {row['promised_hz']:g} promised"
        name = options.shown(key)
        gaps = f"{row['least_s'] * 1e3:.1f} / {row['mean_s'] * 1e3:.1f} / {row['most_s'] * 1e3:.1f}"
        deviation = f"{row['deviation_s'] * 1e3:.1f} ms"
        print(
            f"{name}: {row['hz']:.2f} Hz{promised}; gaps least / mean / most {gaps} ms,"
            f" deviation {deviation}, {row['messages']} messages",
            flush=True,
        )


main: Final = Command(
    "armadico hz",
    Options,
    run,
    "Measure the rate of messages on each key over the last 5 s, with the promised rate and the"
    " least, mean and largest gap between two messages.",
    EXAMPLES,
)
