"""What the MCP server does on the mesh: it asks the assistant agent, and stops the robot."""

from __future__ import annotations

from typing import ClassVar, Final

from armadico.core.guest import Guest
from armadico.core.messages import Message, Stop
from armadico.watch.assistant.messages import AssistantRequest

ASSISTANT: Final = "assistant"  # the agent, as installed


class MCP(Guest):
    """One program's way to a society; a language model has no more rights than these."""

    reads = True
    provides: ClassVar[tuple[type[Message], ...]] = (Stop,)
    queries: ClassVar[tuple[type[Message], ...]] = (AssistantRequest,)
    starts = (ASSISTANT,)
