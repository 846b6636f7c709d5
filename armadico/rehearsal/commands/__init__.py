"""The command `armadico rehearse`."""
