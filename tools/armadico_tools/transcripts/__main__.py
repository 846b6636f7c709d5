"""Write the vectors and the schema, or check an agent: `python -m armadico_tools.transcripts`.

`inputs FILE --agent NAME` prints what an agent receives in a transcript. `replay FILE --agent NAME
--said FILE` compares what the agent published, one JSON object per line with `t`, `key` and `cbor`,
and prints the first difference.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from armadico_tools.transcripts.cddl import schema
from armadico_tools.transcripts.replay import difference_of, inputs, read
from armadico_tools.transcripts.vectors import VECTORS

DOCS: Final = Path(__file__).resolve().parents[3] / "docs"
FOLDER: Final = DOCS / "transcripts"


def files() -> dict[Path, str]:
    """The files that are generated from the code."""
    vectors = "".join(json.dumps(vector.line()) + "\n" for vector in VECTORS)
    return {FOLDER / "vectors.jsonl": vectors, DOCS / "protocol.cddl": schema()}


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m armadico_tools.transcripts",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command")
    for name, text in (
        ("replay", "compare the messages that an agent published"),
        ("inputs", "print the messages that an agent receives"),
    ):
        command = commands.add_parser(name, help=text)
        command.add_argument("file", type=Path, help="transcript")
        command.add_argument("--agent", required=True, help="process in the transcript")
        if name == "replay":
            command.add_argument(
                "--said", type=Path, required=True, help="published messages; - is stdin"
            )
    args = parser.parse_args(argv)
    if args.command is None:
        for path, text in files().items():
            path.write_text(text, encoding="utf-8")
        return 0
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
    text = sys.stdin.read() if str(args.said) == "-" else args.said.read_text(encoding="utf-8")
    why = difference_of(transcript, part.label, [json.loads(x) for x in text.splitlines()])
    print(why or f"{part.label} publishes what {transcript.scene} has")
    return 1 if why else 0


if __name__ == "__main__":
    sys.exit(main())
