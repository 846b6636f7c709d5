"""Write the transcripts, the vectors and the schema: `python -m armadico_tools.transcripts`.

`--check` writes nothing and fails if one is stale. `replay FILE --agent NAME` lets our own agent
live through a transcript and prints the first difference; with `--said FILE` it compares what
another program published, one JSON object a line with `t`, `key` and `cbor`. `inputs FILE --agent
NAME` prints what that program is to be given.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Final

from armadico_tools.docs import ROOT
from armadico_tools.transcripts.cddl import schema
from armadico_tools.transcripts.replay import difference_of, first_difference, inputs
from armadico_tools.transcripts.scenes import SCENES, transcribed
from armadico_tools.transcripts.tape import read
from armadico_tools.transcripts.vectors import VECTORS

FOLDER: Final = "docs/transcripts"


@cache
def files() -> dict[str, str]:
    """Every file that is written, by its path in the checkout. The scenes are played once."""
    found = {f"{FOLDER}/{scene.name}.jsonl": transcribed(scene).text() for scene in SCENES}
    vectors = "".join(json.dumps(vector.line()) + "\n" for vector in VECTORS)
    return found | {f"{FOLDER}/vectors.jsonl": vectors, "docs/protocol.cddl": schema()}


def stale(root: Path = ROOT) -> dict[str, str | None]:
    """The files that are stale, and what they should be; None: not there."""
    wanted: dict[str, str | None] = dict(files())
    there = {f"{FOLDER}/{path.name}" for path in (root / FOLDER).glob("*.jsonl")}
    wanted.update(dict.fromkeys(there - set(wanted)))
    return {name: text for name, text in wanted.items() if _read(root / name) != text}


def write(root: Path = ROOT) -> list[str]:
    """Write what is stale; the names of it."""
    old = stale(root)
    for name, text in old.items():
        if text is None:
            (root / name).unlink()
        else:
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).write_text(text, encoding="utf-8")
    return list(old)


def main(argv: Sequence[str] | None = None) -> int:
    """Write, look, replay or list."""
    parser = argparse.ArgumentParser(
        prog="python -m armadico_tools.transcripts",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--check", action="store_true", help="write nothing; fail if it is stale")
    commands = parser.add_subparsers(dest="command")
    for name, text in (("replay", "compare an agent's output"), ("inputs", "what it is given")):
        command = commands.add_parser(name, help=text)
        command.add_argument("file", type=Path, help="a transcript")
        command.add_argument("--agent", required=True, help="which of its processes")
        if name == "replay":
            command.add_argument("--said", type=Path, help="another program's output; - is stdin")
    args = parser.parse_args(argv)
    if args.command is None:
        return _refresh(check=args.check)
    transcript = read(args.file.read_text(encoding="utf-8"))
    try:
        part = transcript.part(args.agent)
    except KeyError:
        labels = ", ".join(part.label for part in transcript.agents)
        parser.error(f"no agent {args.agent!r} in {args.file}; there are: {labels}")
    if args.command == "inputs":
        for line in inputs(transcript, part.label):
            print(json.dumps(line))
        return 0
    if args.said is None:
        why = first_difference(transcript, part.label)
    else:
        text = sys.stdin.read() if str(args.said) == "-" else args.said.read_text(encoding="utf-8")
        why = difference_of(transcript, part.label, [json.loads(x) for x in text.splitlines()])
    print(why or f"{part.label} publishes what {transcript.scene} has")
    return 1 if why else 0


def _refresh(*, check: bool) -> int:
    names = list(stale()) if check else write()
    for name in names:
        print(f"{name}: {'stale' if check else 'written'}")
    return 1 if check and names else 0


def _read(path: Path) -> str | None:
    return path.read_text(encoding="utf-8") if path.exists() else None


if __name__ == "__main__":
    sys.exit(main())
