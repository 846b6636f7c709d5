"""What of the local map a file or ``--set KEY=VALUE`` may change, within the agent's parameters.

A file of its own for the reason that `armadico.core.parameters` is one.
"""

from __future__ import annotations

from math import radians

from msgspec import Struct


class MapSettings(Struct, frozen=True):
    """How the local map believes and forgets. Probabilities are shares, not calibrated."""

    reach_m: float = 2.5  # of the outermost ring
    hit: float = 0.6  # added where an echo comes from
    miss: float = 0.35  # taken where an echo from farther away went through
    silence: float = 0.15  # taken where a ping brought nothing back at all
    axis_rad: float = radians(10)  # a point within this of a sonar's axis had to echo
    memory: float = 0.995  # a cycle: what is certain lasts 24 s at rest
    memory_m: float = 1.5  # the way that halves a probability: the same lasts 2.6 m
    threshold: float = 0.3  # occupied from here on
    seen_decay: float = 1.0  # a cycle, where a sonar looks: 1, no look is no evidence
    seen_threshold: float = 0.3  # and occupied there; the set `thesis` believes by cycles
    forget: float = 0.05  # a cell below this is dropped
    margin_m: float = 0.1  # an echo clears what lies this much before it
    apart_m: float = 0.06  # points of a near cell farther apart than this are two; 1: one a cell
    frontal_rad: float = radians(40)  # in front: within this of the heading
    abeam_rad: float = radians(120)  # beside: between that and this
