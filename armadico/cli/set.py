"""Change parameters of an agent that is at work: its speed, a margin, its patience."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from armadico.cli import options
from armadico.cli.get import shown
from armadico.cli.parsing import Command, argument, flag, group, option

EXAMPLES: Final = """\
  armadico get goto                          what may be changed, and to what
  armadico set goto v_max=0.4
  armadico set goto v_max=none               as if nobody had set it
  armadico set avoid v_top=0.3 safety.margin_m=0.12
  armadico set goto v_max=0.4 --save         for the next start, too
  armadico up --parameters parameters.toml   which is so
"""

Value = bool | float | str | None


@dataclass(frozen=True, kw_only=True)
class Options:
    agent: str = argument("a name, or an instance's id", metavar="AGENT")
    values: tuple[str, ...] = argument("as `armadico get` shows", nargs="+", metavar="NAME=VALUE")
    save: bool = flag("in parameters.toml of this folder, too")
    file: Path | None = option("or in this file", metavar="FILE")
    timeout: float = options.timeout_option("how long the agent may take to answer", 2.0)
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    """Change parameters, all or none."""
    values = dict(map(_read, args.values))
    from armadico.config.parameters import SAVED, save

    with args.mesh.client() as client:
        reply = client.change(args.agent, values, by="armadico set", timeout=args.timeout)
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


main: Final = Command(
    "armadico set",
    Options,
    run,
    "Change parameters of an agent that is at work. It refuses what is out of range, and says"
    " what is right; of several values it takes all or none. Whoever is started again is told;"
    " a society that starts anew begins with what it was started with, unless that is saved.",
    EXAMPLES,
)
