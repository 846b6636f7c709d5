"""The site: built strictly, from the disk as good as from a server, with all that is exported."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import armadico
from armadico_tools.diagrams import FOLDER, diagrams, drawing
from tests.once import Once
from tests.whole.docs.blocks import ROOT

pytest.importorskip("mkdocs")
pytest.importorskip("mkdocstrings_handlers")

from armadico_tools.site import page_of, reference

LOADS = re.compile(r"<(?:script|img|iframe|source|link)\b[^>]*?(?:src|href)=\"?([^\"\s>]+)")


pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, once: Once) -> Path:
    """The folder of the site, built once for all workers."""

    def built() -> str:
        folder = tmp_path_factory.mktemp("site") / "site"
        done = subprocess.run(
            [sys.executable, "-P", "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
            cwd=ROOT,
            env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return str(folder)

    return Path(once("site", built))


def test_every_document_is_a_page(site: Path) -> None:
    names = ["README.md", *(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))]
    pages = [site / page_of(name).replace(".md", ".html") for name in names]
    assert not [page for page in pages if not page.is_file()]
    first = (site / "index.html").read_text(encoding="utf-8")
    menu = {page.relative_to(site).as_posix() for page in pages}
    assert menu <= {*re.findall(r'href="([^"#]+\.html)"', first), "index.html"}


def test_everything_that_is_exported_is_in_the_reference_once(site: Path) -> None:
    told = [name for _, names in reference() for name in names]
    assert sorted(name.rpartition(".")[2] for name in told) == sorted(armadico.__all__)
    pages = "".join(p.read_text(encoding="utf-8") for p in (site / "reference").glob("*.html"))
    assert not [name for name in told if f'id="{name}"' not in pages]
    assert 'id="armadico.launch.api.Run.plot"' in pages


def test_nothing_is_loaded_from_elsewhere_and_what_is_loaded_is_there(site: Path) -> None:
    pages = [*site.rglob("*.html")]
    assert len(pages) > 30
    for page in pages:
        base = site if page.name == "404.html" else page.parent
        for target in LOADS.findall(page.read_text(encoding="utf-8")):
            assert not re.match(r"(?:\w+:)?//", target), (page, target)
            if not target.startswith(("data:", "/")):
                assert (base / target.partition("#")[0].partition("?")[0]).is_file(), (page, target)
    sheets = "".join(path.read_text(encoding="utf-8") for path in site.rglob("*.css"))
    assert not re.findall(r"(?:url\(|@import)\s*[\"']?https?:", sheets)


def test_what_is_linked_outside_the_documents_comes_along(site: Path) -> None:
    page = (site / "api.html").read_text(encoding="utf-8")
    assert 'href="files/examples/three_lines.py"' in page
    assert (site / "files/examples/run_and_path.ipynb").read_bytes() == (
        ROOT / "examples" / "run_and_path.ipynb"
    ).read_bytes()


def test_every_diagram_is_drawn_and_shown(site: Path) -> None:
    """`python -m armadico_tools.diagrams` draws what is new."""
    wanted = {drawing(text) for text in diagrams()}
    assert {path.name for path in FOLDER.iterdir()} == wanted
    pages = "".join(page.read_text(encoding="utf-8") for page in site.glob("*.html"))
    assert {*re.findall(r'src="images/diagrams/([^"]+)"', pages)} == wanted
    assert "mermaid" not in pages
