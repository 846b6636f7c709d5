"""Explores every run of the real coordination code, up to a number of faults.

`world` has real contenders and a real owner, and the messages under way. Each cycle is one step,
and every alternative is picked from outside. `identity` decides which worlds are equal from here
on, `search` explores them all, and `recovery` finds those that never recover. `replay` repeats one
run.
"""
