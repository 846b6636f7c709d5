"""A society as tools of the Model Context Protocol: the protocol's lines, and what is answered."""
