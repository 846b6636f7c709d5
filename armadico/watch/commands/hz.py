"""Measure the rates of messages on matching keys."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from armadico.cli import options
from armadico.cli.parsing import Command, flag
from armadico.watch.commands.echo import Listening, receive

if TYPE_CHECKING:
    from armadico.observe.view import Rate

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
        show_at = time.monotonic() + SHOW_S
        received = 0
        while args.count is None or received < args.count:
            item = receive(watcher, args)
            rates.setdefault(item.key, Rate()).add(item.at / 1e9)
            received += 1
            if args.count is None and time.monotonic() >= show_at:
                show_at = time.monotonic() + SHOW_S
                _show(rates, watcher.clock() / 1e9)
        now = max(rate.last or 0.0 for rate in rates.values())
    if args.json:
        print(json.dumps([_row(key, rates[key], now) for key in sorted(rates)], indent=2))
    elif args.count is not None:
        _show(rates, now)
    return 0


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
    for key in sorted(rates):
        row = _row(key, rates[key], now)
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
