"""Draws the documents' Mermaid diagrams, because the site runs no script.

`python -m armadico_tools.diagrams MERMAID.JS` draws new diagrams and removes unused drawings. It
needs Chromium, and `dist/mermaid.min.js` of the npm package `mermaid`. The name of a drawing is a
digest of the diagram's text, so a drawing is never stale.
"""

from __future__ import annotations

import html
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Final

from armadico.cli.options import FailedError, guarded
from armadico.cli.parsing import Command, argument
from armadico_tools.docs import filled

ROOT: Final = Path(__file__).resolve().parents[2]
FOLDER: Final = ROOT / "docs" / "images" / "diagrams"
FENCE: Final = re.compile(r"^```mermaid\n(.*?)^```$", re.MULTILINE | re.DOTALL)

BROWSERS: Final = ("chromium", "chromium-browser", "google-chrome")
QUIET: Final = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
WAITS_MS: Final = 20_000
"""Limit of the browser's virtual time for a drawing, which is not real time."""

PAGE: Final = """\
<!doctype html><meta charset="utf-8"><body>
<script src="{script}"></script>
<script type="module">
mermaid.initialize({{startOnLoad: false, theme: "neutral", htmlLabels: false,
  flowchart: {{htmlLabels: false}}, fontFamily: "sans-serif"}});
const {{svg}} = await mermaid.render("diagram", document.querySelector("pre").textContent);
document.body.innerHTML = svg;
document.body.id = "drawn";
</script>
<pre hidden>{text}</pre>
"""


def drawing(text: str) -> str:
    """The name of the file with a diagram's drawing."""
    return f"{sha256(text.encode()).hexdigest()[:12]}.svg"


def diagrams() -> Iterator[str]:
    """The diagrams of the documents."""
    for path in sorted((ROOT / "docs").glob("*.md")):
        yield from FENCE.findall(filled(path.read_text(encoding="utf-8")))


def draw(text: str, script: Path, browser: str) -> str:
    """The SVG of a diagram. Raises RuntimeError if the browser draws none."""
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder, "page.html")
        page.write_text(PAGE.format(script=script.resolve().as_uri(), text=html.escape(text)))
        show = (f"--virtual-time-budget={WAITS_MS}", "--dump-dom", page.as_uri())
        dom = subprocess.run(
            [browser, *QUIET, f"--user-data-dir={folder}/profile", *show],
            capture_output=True,
            text=True,
            check=True,
        ).stdout
    found = re.search(r'<body id="drawn">.*?(<svg.*</svg>)', dom, re.DOTALL)
    if found is None:
        raise RuntimeError(f"not drawn: {text.splitlines()[0]}")
    # A file needs XML and a size: width="100%" is for a page.
    svg = re.sub(r"<br\s*>", "<br/>", found[1])
    wide, high = re.search(r'viewBox="\S+ \S+ (\S+) (\S+)"', svg).groups()  # type: ignore[union-attr]
    return re.sub(r'width="100%"', f'width="{wide}" height="{high}"', svg, count=1) + "\n"


@dataclass(frozen=True, kw_only=True)
class Words:
    script: Path = argument("mermaid.min.js", metavar="FILE")


def run(args: Words) -> int:
    """Draw the missing diagrams."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise FailedError(f"none of {', '.join(BROWSERS)} is on the path")
    FOLDER.mkdir(parents=True, exist_ok=True)
    wanted = {drawing(text): text for text in diagrams()}
    for path in FOLDER.iterdir():
        if path.name not in wanted:
            path.unlink()
    for name, text in wanted.items():
        if not (FOLDER / name).exists():
            (FOLDER / name).write_text(draw(text, args.script, browser), encoding="utf-8")
            print(FOLDER / name)
    return 0


PROGRAM: Final = "python -m armadico_tools.diagrams"
main = Command(PROGRAM, Words, run, "Draw the missing diagrams.", f"  {PROGRAM} mermaid.min.js\n")

if __name__ == "__main__":
    sys.exit(guarded(PROGRAM, lambda: main(sys.argv[1:])))
