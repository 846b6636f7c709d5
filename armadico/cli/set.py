"""Change parameters of a running agent: its speed, a margin, a timeout."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from armadico.cli import options
from armadico.cli.get import shown
from armadico.cli.parsing import Command, argument, flag, group, option

EXAMPLES: Final = """\
  armadico get goto                          the parameters that can be changed, and their ranges
  armadico set goto v_max=0.4
  armadico set goto v_max=none               unset it
  armadico set avoid v_top=0.3 safety.margin_m=0.12
  armadico set goto v_max=0.4 --save         also for the next start
  armadico up --parameters parameters.toml   the next start
"""

Value = bool | float | str | None


@dataclass(frozen=True, kw_only=True)
class Options:
    agent: str = argument("an agent's name or instance", metavar="AGENT")
    values: tuple[str, ...] = argument(
        "parameters, as `armadico get` lists them", nargs="+", metavar="NAME=VALUE"
    )
    save: bool = flag("also save them in parameters.toml of this folder")
    file: Path | None = option("save them in this file", metavar="FILE")
    timeout: float = options.timeout_option("wait so long for the agent's answer", 2.0)
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    values = dict(map(_read, args.values))
    from armadico.config.parameters import SAVED, save
    from armadico.core.membership import agent_of

    with args.mesh.client() as client:
        reply = client.change(args.agent, values, by="armadico set", timeout=args.timeout)
    rows = {row.name: row for row in reply.parameters}
    for name in values:
        row = rows[name]
        unit = f" {row.unit}" if row.unit and row.json != "null" else ""
        print(f"{reply.instance}: {name} = {shown(row.json)}{options.shown(unit)}")
    if args.save or args.file is not None:
        path = args.file or Path(SAVED)
        save(path, agent_of(reply.instance), {n: json.loads(rows[n].json) for n in values})
        print(f"saved; start with it by `--parameters {path}` of `up` or `run`")
    return 0


def _read(setting: str) -> tuple[str, Value]:
    """(name, value): a JSON or TOML value, else a string; `none` clears an optional parameter.

    Raises UsageError.
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
    "Change parameters of a running agent. It rejects values out of range; of several values it"
    " accepts all or none. An agent that restarts receives the changed values. A society that is"
    " started again has its original values, unless the changed ones are saved.",
    EXAMPLES,
)
