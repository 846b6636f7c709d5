"""Judge a plug-in by its contract: `python -m armadico.contracts robot create2`."""

from __future__ import annotations

import sys
from importlib import import_module
from typing import Final

from armadico.config.profile import load_profile
from armadico.contracts.contract import Contract
from armadico.core.config_errors import ConfigError
from armadico.core.discovery import agent_class
from armadico.core.errors import UnknownNameError
from armadico.core.judgement import all_of
from armadico.core.mechanisms import coordination

KINDS: Final = {
    "robot": ("robots", "RobotContract", "profile"),
    "agent": ("agents", "AgentContract", "agent"),
    "resource": ("agents", "ResourceContract", "owner"),
    "mechanism": ("mechanisms", "MechanismContract", "coordination"),
    "world": ("worlds", "WorldContract", "world"),
}
"""By the kind of plug-in: the module, the contract, and its attribute for what is judged."""

USAGE: Final = (
    "usage: python -m armadico.contracts"
    " {robot PROFILE, agent NAME, resource OWNER, mechanism NAME, world FILE}\n"
)


def main(words: list[str]) -> int:
    """Print each judgement; return 0 for yes, 1 for no, 3 for unknown, 2 for wrong usage."""
    if len(words) != 2 or words[0] not in KINDS:
        sys.stderr.write(USAGE)
        return 2
    kind, name = words
    module, contract, attribute = KINDS[kind]
    base = getattr(import_module(f"armadico.contracts.{module}"), contract)
    try:
        if kind == "robot":
            load_profile(name)
        if kind == "mechanism":
            coordination(name)
        what = agent_class(name) if kind in {"agent", "resource"} else name
    except (UnknownNameError, ConfigError, ImportError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    judged: Contract = type("Judged", (base,), {attribute: what})()
    found = judged.judge()
    wide = max(map(len, found))
    for check, judgement in found.items():
        cure = f" -> {judgement.cure}" if judgement.cure else ""
        sys.stdout.write(f"{check:{wide}}  {judgement}{cure}\n")
    for each in judged.unchecked():
        sys.stdout.write(f"{'not checked':{wide}}  {each}\n")
    return all_of(found.values()).exit_code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
