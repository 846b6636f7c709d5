"""An experiment: does it matter how the wheels change hands? Ten seeds each, mean ± deviation."""

from statistics import mean, stdev

import armadico

SEEDS = range(10)
MEASURES = {"TT s": "tt_s", "TD m": "td_m", "exchanges": "exchanges", "least m": "min_clearance_m"}

print(f"{'':8}", *(f"{title:>14}" for title in MEASURES))
for exchange in ("smooth", "abrupt"):
    runs = [armadico.run("sc3", virtual=True, seed=s, exchange=exchange).measures for s in SEEDS]
    assert all(run.passed for run in runs), "a mean needs runs that reach the goal"
    columns = [[getattr(run, field) for run in runs] for field in MEASURES.values()]
    print(f"{exchange:8}", *(f"{mean(c):7.2f} ± {stdev(c):4.2f}" for c in columns))
