"""The messages by which certificates are renewed."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from armadico.core.messages import Message, Text
from armadico.core.services import query

Certificate = Annotated[bytes, Meta(max_length=8192)]  # PEM


class Renewal(Message, frozen=True):
    """Requests a new certificate of the same name and key as the present one.

    Anybody may: without the private key a certificate is of no use.
    """

    certificate: Certificate


class Renewed(Message, frozen=True):
    """The new certificate, or why there is none."""

    certificate: Certificate = b""
    refusal: Text = ""


query(Renewal, "keys/renew", Renewed, "a new certificate for the key of the present one")
