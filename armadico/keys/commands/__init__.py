"""The command `armadico keys`."""
