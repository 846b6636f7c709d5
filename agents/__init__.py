"""One file an agent; nobody imports another."""
