"""Fault tests: deliberate faults, and a checker that uses only what can be observed.

`plan` has faults as data, drawn from a seed. `injector` applies them to a society on the virtual
mesh (with `stranger`, driven by `workload`), `live` to real processes (`trials` has the figures
measured there). `observations` has what is seen with either, or in a recording; `record` what
follows from it, `figures` the times. `checker` has the
promises, `sightings` the situations that a campaign must show, `series` the sums. `shrink` makes a
case small, and `campaign` is the command.
"""

from typing import Final

SEEDS: Final = 20
"""Default number of seeds of a campaign on the virtual mesh."""

MINUTES: Final = 2.0
"""Default of the simulated minutes per seed."""

TRIALS: Final = 30
"""Default number of trials of each kind on real processes."""
