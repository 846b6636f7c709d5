"""The section [p2os] of a profile: a robot with a controller that speaks P2OS.

The conversion factors are in the controller's own units.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Annotated, ClassVar

from msgspec import Meta, Struct
from msgspec.structs import replace

from armadico.config.profile import IdentifiedRobot, Positive, Section, SonarRing, load_profile
from armadico.config.shipped import names
from armadico.core.config_errors import ConfigNameError
from armadico.core.messages import Patience


class Variant(Struct, frozen=True, forbid_unknown_fields=True):
    """Another subclass of the same robot; factors not given are those of the profile."""

    subclass: Annotated[str, Meta(max_length=19)]  # "": a controller that reports none
    distance_mm: Positive | None = None
    range_mm: Positive | None = None


class P2osUnits(Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Conversion factors, and the controller's report of itself."""

    distance_mm: Positive  # mm for one count of XPOS
    angle_rad: Positive  # rad for one unit of THPOS
    velocity_mm: Positive
    range_mm: Positive
    vel2_mm: Positive
    diff_conv: Positive
    name: Annotated[str, Meta(min_length=1, max_length=19)]
    class_name: Annotated[str, Meta(min_length=1, max_length=19)]
    subclass: Annotated[str, Meta(min_length=1, max_length=19)]
    watchdog_s: Patience
    variants: tuple[Variant, ...] = ()

    def of(self, class_name: str, subclass: str) -> P2osUnits | None:
        """The factors for a controller with these names; None: the profile does not match it."""
        if class_name.casefold() != self.class_name.casefold() and (class_name or subclass):
            return None
        if subclass.casefold() == self.subclass.casefold():
            return self
        for each in self.variants:
            if subclass.casefold() == each.subclass.casefold():
                return replace(
                    self,
                    subclass=each.subclass,
                    distance_mm=each.distance_mm or self.distance_mm,
                    range_mm=each.range_mm or self.range_mm,
                )
        return None


class P2osRobot(IdentifiedRobot, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A robot with a controller that speaks P2OS, with known masses and motors."""

    section: ClassVar[str] = "p2os"

    sonar: SonarRing
    p2os: P2osUnits


def profiles_for(class_name: str, subclass: str) -> tuple[str, ...]:
    """The names of the shipped profiles that match a controller with these names, sorted."""
    found = []
    for name in names("robots"):
        with suppress(ConfigNameError):  # a robot of a kind that is not installed
            profile = load_profile(name)
            if isinstance(profile, P2osRobot) and profile.p2os.of(class_name, subclass):
                found.append(name)
    return tuple(found)
