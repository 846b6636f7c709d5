"""What is installed is found by name, imported when used, and named if it is broken."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from armadico.core import discovery
from armadico.core.discovery import AGENTS
from armadico.core.installed import load_all


@pytest.fixture
def third_party(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Another package with an agent, what is none, and a module that ends the program."""
    (tmp_path / "elsewhere.py").write_text(
        '"""An agent from elsewhere.\n\nMore."""\n'
        "from armadico.core.agent import Agent\n"
        "class Dance(Agent):\n    name = 'dance'\n"
        "class Chair: ...\n"
    )
    info = tmp_path / "elsewhere-2.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: elsewhere\nVersion: 2.0\n")
    (info / "entry_points.txt").write_text(
        "[armadico.agents]\n"
        "dance = elsewhere:Dance\nchair = elsewhere:Chair\nends = elsewhere_ends:Agent\n"
        "[armadico.messages]\nends = elsewhere_ends\n"
    )
    (tmp_path / "elsewhere_ends.py").write_text("import sys\nsys.exit(7)\n")
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    sys.modules.pop("elsewhere", None)


def test_an_agent_of_another_package_is_found_and_not_imported(third_party: Path) -> None:
    found = discovery.find(AGENTS, "dance")
    assert (found.package, found.summary) == ("elsewhere", "An agent from elsewhere")
    assert "elsewhere" not in sys.modules
    assert discovery.agent_class("dance").name == "dance"


def test_a_module_that_ends_the_program_is_named_and_ends_nothing(
    third_party: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(ImportError, match=r"ends \(elsewhere_ends:Agent\) cannot be loaded"):
        discovery.agent_class("ends")
    load_all.__wrapped__()
    assert "package elsewhere: armadico.messages, ends = elsewhere_ends is left out" in caplog.text


def test_what_is_no_agent_is_refused(third_party: Path) -> None:
    with pytest.raises(ImportError, match=r"^chair \(elsewhere:Chair\) .*Agent"):
        discovery.agent_class("chair")
