"""Faults made on purpose, and a checker that knows the promises and nothing of the faults' makers.

`observations` is what the checker looks at, `checker` what it promises to notice; both are used on
the virtual mesh and on what was recorded of real processes. The rest makes faults on the virtual
mesh: `plan` draws them from a seed, `injector` and `stranger` put them in, `workload` drives,
`sightings` counts what happened, `shrink` finds the few that matter, `series` adds up.
"""
