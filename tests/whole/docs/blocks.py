"""The fenced blocks of the documentation, each with the comment that stands before it.

| comment before a block | meaning |
| --- | --- |
| none | shell commands are run by `test_commands.py`, each block alone in an empty folder |
| `<!-- not run: REASON -->` | nobody runs it, for that reason |
| `<!-- session: NAME -->` | run by `test_tutorial.py`, in order, in a society that is up |
| `<!-- file: PATH -->` | the contents of a file that the commands after it need |
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]

PROGRAMS = {"armadico", "armadico-agent", "make", "pip", "python", "git", "docker", "sudo"}
"""What a block begins with that is commands, though its fence has no language."""

FENCE = re.compile(
    r"(?:^<!-- (?P<note>[a-z ]+): (?P<value>[^\n]*?) -->\n)?"
    r"^```(?P<language>[\w-]*)\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)

NOTES = {"not run", "session", "file"}


@dataclass(frozen=True)
class Block:
    """One fenced block."""

    document: str
    line: int
    language: str
    text: str
    note: str = ""
    value: str = ""

    @property
    def is_commands(self) -> bool:
        """Whether a shell is meant to run it."""
        if self.language in {"sh", "bash", "console", "shell"}:
            return True
        return not self.language and not PROGRAMS.isdisjoint(self.text.split(maxsplit=1)[:1])

    def __str__(self) -> str:
        return f"{self.document}:{self.line}"


def documents() -> list[Path]:
    """Everything that a reader may take commands from."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def blocks_of(text: str, document: str = "") -> list[Block]:
    """The blocks of one document."""
    return [
        Block(
            document,
            text.count("\n", 0, found.start("text")),
            found["language"],
            found["text"],
            found["note"] or "",
            found["value"] or "",
        )
        for found in FENCE.finditer(text)
    ]


def blocks() -> list[Block]:
    """The blocks of all documents."""
    return [
        block
        for path in documents()
        for block in blocks_of(path.read_text(encoding="utf-8"), str(path.relative_to(ROOT)))
    ]


def files(document: str) -> dict[str, str]:
    """The files that a document shows, by their paths."""
    return {b.value: b.text for b in blocks() if b.document == document and b.note == "file"}
