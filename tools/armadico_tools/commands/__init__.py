"""Commands of the laboratory: `armadico bench`, `armadico faults` and so on."""
