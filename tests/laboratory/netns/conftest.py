"""Hosts as network namespaces: only root may have them, and the reason is printed elsewhere."""

from __future__ import annotations

import pytest

from armadico_tools.hosts.namespaces import lacking


@pytest.fixture(scope="session", autouse=True)
def namespaces() -> None:
    trouble = lacking()
    if trouble is not None:
        pytest.skip(trouble)
