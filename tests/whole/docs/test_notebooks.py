"""The notebooks in `examples/`, executed as they stand, but for the number of seeds."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("ipykernel")
pytest.importorskip("matplotlib")

from jupyter_client.manager import KernelManager

from tests.whole.docs.blocks import ROOT

EXAMPLES = ROOT / "examples"
SHOWS: dict[str, tuple[int, str]] = {
    "run_and_path.ipynb": (2, "reached; 3"),
    "own_agent.ipynb": (1, "'shy': 1"),
    "thirty_seeds.ipynb": (1, "smooth - abrupt"),
}
"""How many pictures each of them draws, and what it prints."""

Execute = Callable[[str], list[dict[str, Any]]]


def code(name: str) -> list[dict[str, Any]]:
    cells = json.loads((EXAMPLES / name).read_text(encoding="utf-8"))["cells"]
    return [cell for cell in cells if cell["cell_type"] == "code"]


@pytest.fixture(scope="module")
def execute(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Execute]:
    """Executes a cell and gives its outputs; one kernel for all, as one starts like a run."""
    folder = tmp_path_factory.mktemp("notebooks")
    with pytest.MonkeyPatch.context() as patched:
        for variable in ("IPYTHONDIR", "JUPYTER_CONFIG_DIR", "JUPYTER_RUNTIME_DIR"):
            patched.setenv(variable, str(folder / variable))  # nothing of a person's own
        manager = KernelManager(kernel_name="python3")
        manager.start_kernel(cwd=str(folder))
    client = manager.blocking_client()

    def executed(source: str) -> list[dict[str, Any]]:
        said: list[dict[str, Any]] = []
        answer = client.execute_interactive(
            source, allow_stdin=False, timeout=100.0, output_hook=said.append
        )
        assert answer["content"]["status"] == "ok", "\n".join(answer["content"]["traceback"])
        return [message["content"] for message in said]

    try:
        client.start_channels()
        client.wait_for_ready(timeout=60.0)
        yield executed
    finally:
        client.stop_channels()
        manager.shutdown_kernel(now=True)
        manager.cleanup_resources()


@pytest.mark.parametrize("name", SHOWS)
def test_a_notebook_is_stored_without_what_came_of_it(name: str) -> None:
    assert not [cell for cell in code(name) if cell["outputs"] or cell["execution_count"]]


@pytest.mark.long
@pytest.mark.parametrize("name", SHOWS)
def test_a_notebook_runs_to_its_end(name: str, execute: Execute) -> None:
    execute("%reset -f")
    outputs = [
        out
        for cell in code(name)
        for out in execute("".join(cell["source"]).replace("range(30)", "range(2)"))
    ]
    pictures = [out for out in outputs if "image/png" in out.get("data", {})]
    printed = "".join(out["text"] for out in outputs if out.get("name") == "stdout")
    complaints = [out["text"] for out in outputs if out.get("name") == "stderr"]
    wanted, says = SHOWS[name]
    assert len(pictures) == wanted
    assert says in printed
    assert not complaints
