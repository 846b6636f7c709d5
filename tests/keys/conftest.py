"""A folder of keys, a porter that uses it, and a society that runs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.keys.labs import Lab
from tests.keys.porters import Door
from tests.keys.society import Society


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    return Lab(tmp_path / "keys")


@pytest.fixture
def society(tmp_path: Path) -> Iterator[Society]:
    with ExitStack() as stack:
        yield Society(tmp_path, stack)


@pytest.fixture
def door(lab: Lab, tmp_path: Path) -> Iterator[Door]:
    with ExitStack() as stack:
        yield Door(lab, tmp_path, stack)
