"""The compose file of a cluster: what its services are started with exists, and fits together."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[3]
DEPLOY = ROOT / "deploy"


@pytest.fixture
def services() -> dict[str, Any]:
    text = (DEPLOY / "campaign.yaml").read_text(encoding="utf-8")
    filled = re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", text)
    found: dict[str, Any] = yaml.safe_load(filled)["services"]
    return found


def test_dask_knows_the_words_of_scheduler_and_workers(services: dict[str, Any]) -> None:
    from distributed.cli import dask_scheduler, dask_worker

    for name, command in (("scheduler", dask_scheduler.main), ("worker", dask_worker.main)):
        verb, *words = services[name]["command"]
        assert (services[name]["entrypoint"], verb) == (["dask"], name)
        with command.make_context(name, list(words)) as made:
            if name == "worker":
                assert (made.params["nthreads"], made.params["n_workers"]) == (1, "auto")
                assert made.params["scheduler"] == "tcp://scheduler:8786"
            else:
                assert made.params["port"] == "8786"


def test_each_part_is_of_one_image_unprivileged_and_without_a_way_in(
    services: dict[str, Any],
) -> None:
    for part in services.values():
        assert part["image"] == "armadico-campaign"
        assert part["read_only"]
        assert part["cap_drop"] == ["ALL"]
        assert part["networks"] == ["cluster"]
        assert "ports" not in part


def test_what_has_no_way_out_is_not_sent_to_another_computer(services: dict[str, Any]) -> None:
    composed = yaml.safe_load((DEPLOY / "campaign.yaml").read_text(encoding="utf-8"))
    assert composed["networks"]["cluster"]["internal"]
    (to,) = (word for word in services["worker"]["command"] if word.startswith("tcp://"))
    assert to.removeprefix("tcp://").partition(":")[0] in services
