"""The agent `keys`: renews the certificates of a society's processes.

It runs on the computer that has the authority's key, as one process in the host table. Without it
all processes go on until their certificates expire.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, ClassVar

from msgspec import Meta

from armadico.core import agent
from armadico.core.agent import WARNING, Agent, Identity, Question
from armadico.core.config_errors import ConfigError
from armadico.core.messages import Message
from armadico.keys.authority import CLIENT_HOURS, KeyFileError, facts
from armadico.keys.door import opened
from armadico.keys.issuing import Issuer
from armadico.keys.messages import Renewal, Renewed
from armadico.keys.store import Store

Hours = Annotated[float, Meta(gt=0, le=8760)]


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """How it issues."""

    hours: Hours = CLIENT_HOURS
    """How long a certificate is valid, h."""

    folder: str = ""
    """The folder of keys, with the authority's key. Empty: the host table's."""


class Keys(Agent):
    """Renews the certificates of a society's processes."""

    name: ClassVar[str] = "keys"
    parameters: ClassVar[type[agent.Parameters]] = Parameters
    answers: ClassVar[tuple[type[Message], ...]] = (Renewal,)
    p: Parameters

    wall: Callable[[], datetime] = staticmethod(lambda: datetime.now(UTC))
    """Returns the time by which certificates are valid."""

    def __init__(self, identity: Identity, parameters: agent.Parameters | None = None) -> None:
        """Read the authority's key. Raises ConfigError if it is not on this computer."""
        super().__init__(identity, parameters)
        folder = self.p.folder or opened()
        if not folder:
            raise ConfigError(
                "the agent `keys` renews certificates, and this society has none: a host table with"
                ' keys = "FOLDER" does (`armadico keys init`)'
            )
        self._issuer = Issuer.of(Store(Path(folder)), self.p.hours)
        self._refused: set[tuple[str, str]] = set()

    def on_renewal(self, request: Renewal, _question: Question) -> Renewed:
        try:
            return Renewed(self._issuer.again(request.certificate, self.wall()))
        except (ConfigError, KeyFileError) as error:
            self._report(request.certificate, str(error))
            return Renewed(refusal=str(error)[:2000])

    def _report(self, certificate: bytes, why: str) -> None:
        """Log a refusal, once for each name and reason."""
        try:
            name = facts(certificate).name
        except KeyFileError:
            name = ""
        if (name, why) not in self._refused and len(self._refused) < 1000:
            self._refused.add((name, why))
            self.log(f"no renewal for {name or 'a process'}: {why}", WARNING)
