"""The texts of errors are as they stand in `errors.txt`."""

from __future__ import annotations

import pytest

from tests.whole.texts import errors


@pytest.mark.timeout(300)
@pytest.mark.parametrize("group", errors.GROUPS)
def test_errors_read_as_they_are_written(group: str) -> None:
    kept = errors.sections(errors.FILE.read_text())[group]
    assert errors.written(group) == kept, "`python -m tests.whole.texts.errors` writes it again"
