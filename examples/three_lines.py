"""A run in three lines: scenario 4 under a virtual clock, and its result."""

import armadico

done = armadico.run("sc4", virtual=True, seed=7)
print(done.measures.verdict)
