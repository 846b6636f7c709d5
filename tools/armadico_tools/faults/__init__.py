"""One fault bed: faults made on purpose, and a checker that knows the promises only.

`plan` has faults as data, drawn from a seed. `injector` puts them into a society on the virtual
mesh (with `stranger`, driven by `workload`), `live` into real processes (`trials` has what is
measured there). `record` is what was observed on either, or on a recording; `checker` has the
promises, `sightings` the situations that a campaign must show, `series` the sums, `shrink` makes a
case small, and `campaign` is the command.
"""

from typing import Final

SEEDS: Final = 20
"""Seeds of a campaign on the virtual mesh, if no number is given."""

MINUTES: Final = 2.0
"""Simulated minutes of each."""

TRIALS: Final = 30
"""Trials of each kind on real processes."""
