"""A shell for the documentation's commands: sockets and folders of its own, cheaper arguments."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from armadico.mesh.ports import free_port
from armadico.mesh.sockets import RUNTIME_VARIABLE, endpoint, stem
from tests.runtime_folder import fresh_folder
from tests.whole.docs.blocks import ROOT

BLOCK_S = 100.0
"""What one block may take; a deadline, not an expectation."""

SUBSTITUTIONS: tuple[tuple[str, str, str], ...] = (
    # what a document says, what is run instead, why
    (
        r"armadico run ([\w./-]+)$",
        r"armadico run \1 --virtual",
        "live, it takes as long as it takes",
    ),
    (r"--runs \d+", "--runs 2", "as good as thirty, to see that it works"),
    (r"faults --seeds 3", "faults --seeds 1", "as good as three"),
    # Whole ways, by each make of robot, are driven by the tests of `launch` and `missions`.
    (r"armadico run sc4\b", "armadico run sc4 --goal 3.4 1.4 90", "the goal is a metre ahead"),
    (r"armadico run house\b", "armadico run house --goal 1 2 90", "likewise"),
    (r"explore --world house\b", "explore --world house --within 0 0 4.4 4.4", "one room of it"),
    (r"explore sc3\b", "explore sc3 --within 0 0 3 2.6", "whole, by `cli/test_explore.py`"),
    (
        r"--start 1 0\.5 0 --goal 5 0\.6 0",
        "--start 1 0.5 0 --goal 2 0.6 0",
        "on what is known then",
    ),
    (r"run rooms-a\b", "run rooms-a --goal 1.6 1.5 90", "likewise"),
    (r"mission run surveillance\b", "mission run my/brief.toml", "whole, by `missions`"),
    (r"armadico bench\b.*", "armadico bench --list", "it measures for minutes"),
    (r"armadico experiment\b.*", "armadico experiment --list", "thirty seeds a cell take hours"),
    (r"pip install -e '(\S+)\[test\]'", r"pip install \1", "pytest is here"),
    (
        r"pip install ",
        "python -m pip install --quiet --no-deps --no-build-isolation --no-index --target site ",
        "into a folder of the test's own, and not from the network",
    ),
    (r"armadico sim ", "armadico sim --port {port} ", "8101 is everybody's"),
    (r"armadico-agent robot &", "armadico-agent robot --set port=tcp://127.0.0.1:{port} &", "so"),
)
"""The only differences between what is printed and what is run."""


class Shell:
    """Runs blocks in one folder; what they leave in the background ends with it."""

    def __init__(self, folder: Path, namespace: str) -> None:
        self.folder = folder
        self.namespace = namespace
        self.sockets = fresh_folder()
        self._port = free_port()
        self._groups: list[int] = []
        (folder / "configs").symlink_to(ROOT / "configs")

    def __enter__(self) -> Shell:
        return self

    def __exit__(self, *error: object) -> None:
        for group in self._groups:
            with suppress(ProcessLookupError):
                os.killpg(group, signal.SIGKILL)

    @property
    def router(self) -> str:
        """The endpoint of the robot's router."""
        return endpoint(Path(self.sockets) / "armadico" / f"{stem(self.namespace)}.sock")

    def run(self, text: str) -> subprocess.CompletedProcess[str]:
        """Run one block as the documents have it, and wait for what is not in the background."""
        log = self.folder / f"block-{len(self._groups)}.log"
        with log.open("w") as out:
            shell = subprocess.Popen(
                ["bash", "-euc", self.substituted(text)],
                cwd=self.folder,
                env=self.environment(),
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            self._groups.append(shell.pid)
            code = shell.wait(BLOCK_S)
        return subprocess.CompletedProcess(text, code, log.read_text())

    def substituted(self, text: str) -> str:
        for pattern, instead, _ in SUBSTITUTIONS:
            text = re.sub(pattern, instead.replace("{port}", str(self._port)), text, flags=re.M)
        return text

    def environment(self) -> dict[str, str]:
        return os.environ | {
            "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
            "PYTHONPATH": str(self.folder / "site"),
            "ARMADICO_NAMESPACE": self.namespace,
            "TMPDIR": str(self.folder),
            RUNTIME_VARIABLE: self.sockets,
        }

    def write(self, files: dict[str, str]) -> None:
        for name, text in files.items():
            path = self.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
