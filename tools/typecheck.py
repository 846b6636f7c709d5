"""mypy strict over every package, through a folder of links that has the installed layout.

In the checkout `agents/` is `armadico.agents` only for whoever has it installed; mypy on the
checkout would silently leave such folders out. The number of files checked is compared.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PARTS = ("agents", "bridge", "tools", "configs")


def link(into: Path) -> None:
    """Lay out links as the packages are installed."""
    package = into / "armadico"
    package.mkdir()
    for entry in (ROOT / "armadico").iterdir():
        (package / entry.name).symlink_to(entry)
    for part in PARTS:
        (package / part).symlink_to(ROOT / part)


def sources() -> int:
    """How many files there are to check."""
    return sum(len(list((ROOT / part).rglob("*.py"))) for part in ("armadico", *PARTS))


def main() -> int:
    """Run mypy; 0 if it is content and has seen everything."""
    with tempfile.TemporaryDirectory() as folder:
        link(Path(folder))
        done = subprocess.run(
            [
                *(sys.executable, "-m", "mypy", "--config-file", str(ROOT / "pyproject.toml")),
                *("--cache-dir", str(ROOT / ".mypy_cache"), "-p", "armadico"),
            ],
            env={**os.environ, "MYPYPATH": folder},
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
    print(done.stdout.replace(f"{folder}/", ""), done.stderr, sep="", end="")
    checked = re.search(r"(\d+) source files?", done.stdout)
    if checked is None or int(checked[1]) < sources():
        print(f"mypy saw {checked and checked[1]} of {sources()} files", file=sys.stderr)
        return 1
    return done.returncode


if __name__ == "__main__":
    sys.exit(main())
