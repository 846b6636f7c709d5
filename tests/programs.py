"""Our programs as people start them, and what a fresh Python imports."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from armadico.core.discovery import OPTIONS, installed
from armadico.launch.processes import kill_trees

BIN = Path(sys.executable).parent
SOON = 60.0
"""s; a deadline, not an expectation."""

NO_PICTURE = ("--no-plot",) if "picture" in installed(OPTIONS) else ()
"""For a live run, of which a picture would be drawn here if something draws."""

Done = subprocess.CompletedProcess[str]
Start = Callable[..., subprocess.Popen[str]]


def call(
    *words: str,
    program: str = "armadico",
    env: Mapping[str, str] | None = None,
    within: float = SOON,
    **options: Any,
) -> Done:
    """Run one of ours, or another one by its path, to its end."""
    usual = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options
    return subprocess.run(
        [str(BIN / program), *words], text=True, timeout=within, check=False, env=env, **usual
    )


@contextmanager
def starter(
    first: Sequence[str] = (), env: Mapping[str, str] | None = None, **options: Any
) -> Iterator[Start]:
    """Start programs, or a command with more words; each is killed with all that it started."""
    usual = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options
    with ExitStack() as stack:

        def start(*words: str, program: str = "armadico") -> subprocess.Popen[str]:
            command = [*(first or [str(BIN / program)]), *words]
            process = subprocess.Popen(command, text=True, env=env, **usual)
            stack.callback(kill_trees, process)
            return process

        yield start


def heavy(module: str, words: Sequence[str], among: Iterable[str]) -> Done:
    """Have a module's `main` say something; its last line is what it imported of some modules."""
    script = (
        f"import sys\nfrom {module} import main\n"
        f"try:\n    main({list(words)!r})\nexcept SystemExit as end:\n    assert not end.code\n"
        f"print(sorted(set({sorted(among)!r}) & set(sys.modules)))"
    )
    return subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=SOON, check=False
    )


def imports_nothing(done: Done) -> bool:
    """Whether it imported none of them."""
    *_, last = done.stdout.splitlines()
    assert last == "[]", done.stdout + done.stderr
    return True
