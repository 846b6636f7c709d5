"""The contract of worlds: a shipped one keeps it, and a bad file does not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from armadico.contracts.contract import judged
from armadico.contracts.worlds import WorldContract
from armadico.core.judgement import Answer

HEAD = "2D-Map\nLineMinPos: -5000 -5000\nLineMaxPos: 5000 5000\nNumLines: 1\n"
START = 'Cairn: RobotHome 0 0 0.0 "" ICON "RobotHome"\n'
GOAL = 'Cairn: GoalWithHeading 3000 0 0.0 "" ICON "goal"\n'
FAR = "LINES\n-4000 4000 4000 4000\nDATA\n"
ACROSS = "LINES\n1500 -5000 1500 5000\nDATA\n"
NEAR = "LINES\n100 -1000 100 1000\nDATA\n"


class TestSc3(WorldContract):
    world = "sc3"


@pytest.mark.parametrize(
    ("text", "check", "answer", "reason"),
    [
        (HEAD + START + GOAL + FAR, "every_place_can_be_reached", Answer.YES, ""),
        (HEAD + GOAL + FAR, "is_read", Answer.UNKNOWN, "no start"),
        (HEAD + START + NEAR, "start_has_room", Answer.NO, "0.10 m of room"),
        (HEAD + START + GOAL + ACROSS, "every_place_can_be_reached", Answer.NO, "no path"),
        (HEAD + START + FAR, "every_place_can_be_reached", Answer.UNKNOWN, "no goal"),
        ("no map", "is_read", Answer.NO, "ConfigError"),
    ],
)
def test_a_file_is_judged(
    text: str, check: str, answer: Answer, reason: str, tmp_path: Path
) -> None:
    file = tmp_path / "world.map"
    file.write_text(text)
    contract: Any = type("Judged", (WorldContract,), {"world": str(file)})()
    judgement = judged(getattr(contract, f"check_{check}"))
    assert judgement.answer is answer, judgement
    assert reason in judgement.reason
