"""Causes of a stop that a person must remove at the robot.

The robot agent latches the stop with one of these as its `by`. Commands that show or release a stop
report what to do before `armadico resume`.
"""

from __future__ import annotations

from enum import StrEnum

from armadico.core.messages import Stop

RESUME = "`armadico resume` releases it"


class Hand(StrEnum):
    """The `by` of a stop that the robot agent latches, with its remedy."""

    remedy: str

    def __new__(cls, by: str, remedy: str) -> Hand:
        member = str.__new__(cls, by)
        member._value_, member.remedy = by, remedy
        return member

    MOTORS = (
        "the motors being off at the robot",
        "motors are off: press the robot's MOTORS button",
    )
    BUTTON = (
        "the STOP button at the robot",
        "the STOP button is pressed: release it at the robot, and press its MOTORS button",
    )
    LIFTED = (
        "a wheel of the robot hanging in the air",
        "a wheel hangs in the air: set the robot down on all its wheels",
    )
    RESET = (
        "the controller having been reset at the robot",
        "the controller was reset: make sure that nobody is at the robot",
    )
    EXCHANGED = (
        "another controller at the robot's port",
        "another controller answers: make sure that it is the robot that is meant",
    )
    DISOBEYS = (
        "the robot not moving as ordered",
        "the robot does not move as ordered: look at its wheels, motors, encoders and controller",
    )


def keeps_motors_off(stop: Stop) -> bool:
    """Return whether a person at the robot switched the motors off, or keeps them off."""
    return stop.by in (Hand.MOTORS, Hand.BUTTON)


def remedy(stop: Stop, *, motors: bool = True) -> str:
    """Return what to do at the robot before a stop can be released; empty if nothing.

    `motors`: the robot reports that its motors are on.
    """
    hand = next((hand for hand in Hand if hand == stop.by), None)
    if hand is not None and not (keeps_motors_off(stop) and motors):
        return hand.remedy
    return "" if motors else Hand.MOTORS.remedy


def release(stop: Stop, *, motors: bool = True) -> str:
    """Return for people how to release a stop."""
    first = remedy(stop, motors=motors)
    return f"{first}, then `armadico resume`" if first else RESUME
