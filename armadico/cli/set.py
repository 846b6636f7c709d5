"""Change parameters of an agent that is at work: its speed, a margin, its patience."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from armadico.cli import options
from armadico.cli.get import shown

EXAMPLES: Final = """\
  armadico get goto                          what may be changed, and to what
  armadico set goto v_max=0.4
  armadico set goto v_max=none               as if nobody had set it
  armadico set avoid v_top=0.3 safety.margin_m=0.12
  armadico set goto v_max=0.4 --save         for the next start, too
  armadico up --parameters parameters.toml   which is so
"""

Value = bool | float | str | None


def main(argv: Sequence[str]) -> int:
    """Change parameters, all or none."""
    args = parser().parse_args(argv)
    values = dict(map(_read, args.values))
    from armadico.config.parameters import SAVED, save  # noqa: PLC0415 - not for --help
    from armadico.runtime.client import Client  # noqa: PLC0415

    with options.joined(args) as mesh:
        reply = Client(mesh).change(args.agent, values, by="armadico set", timeout=args.timeout)
    rows = {row.name: row for row in reply.parameters}
    for name in values:
        row = rows[name]
        unit = f" {row.unit}" if row.unit and row.json != "null" else ""
        print(f"{reply.instance}: {name} = {shown(row.json)}{options.shown(unit)}")
    if args.save or args.file is not None:
        path = args.file or Path(SAVED)
        save(path, reply.instance.rpartition("-")[0], {n: json.loads(rows[n].json) for n in values})
        print(f"saved: `--parameters {path}` of `up` and `run` starts with it")
    return 0


def parser() -> argparse.ArgumentParser:
    made = options.parser(
        "armadico set",
        "Change parameters of an agent that is at work. It refuses what is out of range, and says"
        " what is right; of several values it takes all or none. Whoever is started again is told;"
        " a society that starts anew begins with what it was started with, unless that is saved.",
        EXAMPLES,
    )
    made.add_argument("agent", metavar="AGENT", help="a name, or an instance's id")
    made.add_argument("values", nargs="+", metavar="NAME=VALUE", help="as `armadico get` shows")
    made.add_argument("--save", action="store_true", help="in parameters.toml of this folder, too")
    made.add_argument("--file", type=Path, metavar="FILE", help="or in this file")
    options.add_timeout(made, "how long the agent may take to answer", 2.0)
    options.add_mesh_options(made)
    return made


def _read(setting: str) -> tuple[str, Value]:
    """A value as in JSON or TOML; what is neither is a word, and none clears an optional one.

    Raises UsageError for what is no setting.
    """
    name, equals, text = (part.strip() for part in setting.partition("="))
    if not (name and equals and text):
        raise options.UsageError(f"{setting}: expected NAME=VALUE, for instance v_max=0.4")
    words: dict[str, Value] = {"none": None, "true": True, "false": False}
    if text in words:
        return name, words[text]
    try:
        return name, int(text) if text.lstrip("+-").isdigit() else float(text)
    except ValueError:
        return name, text
