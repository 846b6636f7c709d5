"""P2OS, the protocol of the Pioneers: framing, commands, packets, session."""
