"""One file per agent; no agent imports another."""
