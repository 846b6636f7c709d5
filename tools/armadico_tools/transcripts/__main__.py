"""Write the schema and the vectors, or check an agent: `python -m armadico_tools.transcripts`.

`inputs FILE --agent NAME` prints what an agent receives in a transcript. `replay FILE --agent NAME
--said FILE` compares what the agent published, one JSON object per line with `t`, `key` and `cbor`,
and prints the first difference.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from armadico.cli.options import UsageError, guarded
from armadico.cli.parsing import Command, argument, option
from armadico.core.messages import decode, encode
from armadico_tools.transcripts.cddl import schema
from armadico_tools.transcripts.replay import (
    KINDS,
    Line,
    difference_of,
    fields_of,
    inputs,
    read,
)

DOCS: Final = Path(__file__).resolve().parents[3] / "docs"
FOLDER: Final = DOCS / "transcripts"
VECTORS: Final = FOLDER / "vectors.jsonl"

EXAMPLES: Final = """\
  python -m armadico_tools.transcripts            write docs/protocol.cddl and the vectors
  python -m armadico_tools.transcripts inputs docs/transcripts/take-over.jsonl --agent b
  python -m armadico_tools.transcripts replay FILE --agent b --said mine.jsonl
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    what: str | None = argument(
        "print an agent's inputs, or compare what it published (default: write the files)",
        nargs="?",
        choices=("inputs", "replay"),
    )
    file: Path | None = argument("transcript", nargs="?", metavar="FILE")
    agent: str = option("process in the transcript", default="", metavar="NAME")
    said: Path | None = option("published messages; - is stdin", metavar="FILE")


def run(args: Options) -> int:
    if args.what is None:
        for path, text in files().items():
            path.write_text(text, encoding="utf-8")
        return 0
    if args.file is None or not args.agent:
        raise UsageError(f"{args.what} needs a transcript and --agent")
    transcript = read(args.file.read_text(encoding="utf-8"))
    try:
        label = transcript.part(args.agent).label
    except KeyError:
        labels = ", ".join(part.label for part in transcript.agents)
        raise UsageError(f"no agent {args.agent!r} in {args.file}; there are: {labels}") from None
    if args.what == "inputs":
        for line in inputs(transcript, label):
            print(json.dumps(line))
        return 0
    if args.said is None:
        raise UsageError("replay needs --said: the published messages")
    text = sys.stdin.read() if str(args.said) == "-" else args.said.read_text(encoding="utf-8")
    why = difference_of(transcript, label, [json.loads(x) for x in text.splitlines()])
    print(why or f"{label} publishes what {transcript.scene} has")
    return 1 if why else 0


main = Command("python -m armadico_tools.transcripts", Options, run, str(__doc__), EXAMPLES)


def files() -> dict[Path, str]:
    """The files that are written again: the schema, and the vectors with their fields.

    A vector is added by hand, by `what`, `accepted`, `type` and `cbor`.
    """
    lines = map(json.loads, VECTORS.read_text(encoding="utf-8").splitlines())
    vectors = "".join(json.dumps(_complete(line)) + "\n" for line in lines)
    return {VECTORS: vectors, DOCS / "protocol.cddl": schema()}


def payload_of(line: Line) -> bytes:
    """The bytes of a vector."""
    return bytes.fromhex(line["cbor"]) + bytes(line.get("zeros", 0))


def _complete(line: Line) -> Line:
    """A vector with the fields of an accepted payload, and our encoding."""
    if not line["accepted"]:
        return line
    message = decode(payload_of(line), KINDS[line["type"]])
    return {**line, "fields": fields_of(message), "ours": encode(message).hex()}


if __name__ == "__main__":
    sys.exit(guarded(main.program, lambda: main(sys.argv[1:])))
