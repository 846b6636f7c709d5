"""The requests that a browser may send."""

from __future__ import annotations

import json

import pytest

from armadico.observe.page_requests import (
    LONGEST,
    RequestError,
)
from armadico.watch.page.model import reader

READER = reader()
GOTO = {"do": "go", "id": 1, "robot": "robot1", "x": 1.5, "y": -2}


@pytest.mark.parametrize(
    "data",
    [
        *("", "null", '{"do":"go"}', '"' + "x" * LONGEST, b"\xff\xfe", "[" * 4000),
        json.dumps(GOTO | {"do": "command"}),
        json.dumps(GOTO | {"x": 1e7}),
        json.dumps(GOTO | {"x": float("nan")}),
        json.dumps(GOTO | {"x": "1"}),
        json.dumps(GOTO | {"robot": ""}),
        json.dumps(GOTO | {"robot": "\x1b[2J"}),
        json.dumps(GOTO | {"utility": 1.0}),
        json.dumps({"do": "stick", "id": 3, "robot": "r", "v": 1.01, "w": 0, "cycle": 7}),
        json.dumps({"do": "resume", "id": 2, "robot": "r", "press": 1}),
    ],
)
def test_other_requests_are_refused(data: str | bytes) -> None:
    with pytest.raises(RequestError):
        READER.read(data)
