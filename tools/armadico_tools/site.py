"""A hook of MkDocs (`mkdocs.yml`) that makes the site from the documents.

The documents link each other as files of the checkout, for reading on GitHub. For the site the
README becomes the first page. Linked files outside `docs/` are added, Markdown as pages and others
as files. Generated parts are filled in (`armadico_tools.docs`). Diagrams, which would need a
script, are drawn before (`armadico_tools.diagrams`). The reference has a page for each part of what
`armadico` exports, from its docstrings.
"""

from __future__ import annotations

import os
import posixpath
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Final

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from armadico_tools.diagrams import FENCE, drawing
from armadico_tools.docs import filled

SURFACE: Final = import_module("armadico")
"""The exported names, all of which are documented."""

ROOT: Final = Path(__file__).resolve().parents[2]

LINK: Final = re.compile(r"(?<!`)(\[(?:[^\]\[]|\[[^\]]*\])*\]\()([^)\s]+)(\))")
ELSEWHERE: Final = ("http://", "https://", "mailto:", "#")

REFERENCE: Final = (
    ("Runs", ("launch.api", "observe.measures", "config.scenarios")),
    ("Guests", ("launch.client",)),
    ("Agents", ("core.agent", "mobile.behaviour", "core.exchange", "core.resources")),
    ("What agents stand on", ("core.parameters", "mobile.route", "mobile.resources")),
    ("Tasks of missions", ("agents.missions.task", "agents.missions.planner")),
    ("Messages", ("core.messages", "mobile.messages", "mobile.obstacles")),
    ("Errors", ("runtime.errors", "core.config_errors", "core.discovery", "mesh.topology")),
)
"""The pages of the reference, and their modules; other modules go to the last page."""

SHIM: Final = ("https://unpkg.com/iframe-worker/shim", "site/iframe-worker.js")
"""The script that search needs for pages read from disk: Material's address, and ours."""

BESIDES: Final = ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")


def page_of(path: str) -> str:
    """The page of a file of the checkout."""
    if path == "README.md":
        return "index.md"
    if path.startswith("docs/"):
        return path.removeprefix("docs/")
    if path.endswith(".md"):
        return f"project/{path.replace('/', '-').lower()}"
    return f"files/{path}"


def source_of(uri: str) -> str | None:
    """The file of the checkout for a page, or None."""
    return _SOURCES.get(uri, f"docs/{uri}" if (ROOT / "docs" / uri).is_file() else None)


_SOURCES: dict[str, str] = {}


def links(path: str) -> Iterator[str]:
    """The files of the checkout that a file links to."""
    for _, target, _ in LINK.findall((ROOT / path).read_text(encoding="utf-8")):
        if not target.startswith(ELSEWHERE):
            place = target.partition("#")[0]
            yield posixpath.normpath(posixpath.join(posixpath.dirname(path), place))


def sources() -> list[str]:
    """The files of the checkout in the site: the documents, and all that they link to."""
    waiting = ["README.md", *BESIDES]
    waiting += [f"docs/{path.name}" for path in sorted((ROOT / "docs").glob("*.md"))]
    found: dict[str, None] = {}
    for path in waiting:  # grows during the loop
        if path not in found and (ROOT / path).is_file():
            found[path] = None
            waiting += links(path) if path.endswith(".md") else ()
    return list(found)


def project() -> list[str]:
    """Pages outside `docs/`, except the first page."""
    pages = [path for path in sources() if path.endswith(".md") and path != "README.md"]
    return [path for path in pages if not path.startswith("docs/")]


def reference() -> Iterator[tuple[str, list[str]]]:
    """Each page's title and the full names that it documents."""
    homes = {name: _home(name) for name in SURFACE.__all__}
    listed = {module for _, modules in REFERENCE for module in modules}
    for title, modules in REFERENCE:
        others = REFERENCE[-1][0] == title
        names = [
            f"armadico.{home}.{name}"
            for module in (*modules, *(sorted({*homes.values()} - listed) if others else ()))
            for name, home in homes.items()
            if home == module
        ]
        yield title, names


def _home(name: str) -> str:
    return next(
        (module for module, names in SURFACE._MODULES.items() if name in names), "core.messages"
    )


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Complete the navigation: unlisted documents, the reference, and the project's pages."""
    nav: list[object] = list(config.nav or [])
    there = set(re.findall(r"[\w/-]+\.md", str(nav)))
    more = sorted({path.name for path in (ROOT / "docs").glob("*.md")} - there)
    if more:
        nav.append({"More": list(more)})
    nav.append({"Python reference": [f"reference/{_slug(title)}.md" for title, _ in reference()]})
    nav.append({"Project": [page_of(path) for path in project()]})
    config.nav = nav
    return config


def _slug(title: str) -> str:
    return title.lower().replace(" ", "-")


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the pages outside `docs/`."""
    for title, names in reference():
        text = "\n\n".join([f"# {title}", *(f"::: {name}" for name in names)])
        files.append(File.generated(config, f"reference/{_slug(title)}.md", content=text))
    for path in sources():
        if not path.startswith("docs/"):
            _SOURCES[page_of(path)] = path
            files.append(File.generated(config, page_of(path), abs_src_path=str(ROOT / path)))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Fill in generated parts, point links to pages, and replace diagrams by their drawings."""
    del config, files
    source = source_of(page.file.src_uri)
    if source is None:
        return markdown
    here = posixpath.dirname(page.file.src_uri) or "."

    def relink(found: re.Match[str]) -> str:
        target = found[2]
        if target.startswith(ELSEWHERE):
            return found[0]
        place, mark, anchor = target.partition("#")
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), place))
        if (ROOT / path).is_dir():
            return found[1][1:-2]  # the site has no listings of folders
        if not (ROOT / path).is_file():
            return found[0]  # MkDocs reports it
        return f"{found[1]}{os.path.relpath(page_of(path), here)}{mark}{anchor}{found[3]}"

    def drawn(found: re.Match[str]) -> str:
        name = f"images/diagrams/{drawing(found[1])}"
        there = os.path.relpath(name, here)
        return f"[![A diagram]({there})]({there})"

    parts = re.split(r"(^```.*?^```$)", filled(markdown), flags=re.MULTILINE | re.DOTALL)
    for number, part in enumerate(parts):
        parts[number] = FENCE.sub(drawn, part) if part.startswith("```") else LINK.sub(relink, part)
    return "".join(parts)


def on_post_page(output: str, *, page: Page, config: MkDocsConfig) -> str:
    """Load nothing from other sites."""
    del config
    up = "../" * page.url.count("/")
    return output.replace(SHIM[0], up + SHIM[1])


def on_post_template(output_content: str, *, template_name: str, config: MkDocsConfig) -> str:
    """The same for the page of error 404."""
    del template_name, config
    return output_content.replace(*SHIM)
