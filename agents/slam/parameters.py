"""Numbers of which the parameters of SLAM are made; a zero would divide, or end nothing."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

Positive = Annotated[float, Meta(gt=0, lt=1e6)]
Count = Annotated[int, Meta(gt=0, lt=1_000_000)]
