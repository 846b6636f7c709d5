"""By what a robot was stopped that a person has to attend to at the robot, and what has to be done.

The robot agent latches the stop with one of these as its `by`. Commands that show or release a stop
tell people from it what comes before `armadico resume`.
"""

from __future__ import annotations

from enum import StrEnum

from armadico.core.messages import Stop

RESUME = "`armadico resume` releases it"


class Hand(StrEnum):
    """By what the robot agent latches the stop."""

    remedy: str

    def __new__(cls, by: str, remedy: str) -> Hand:
        """Make a member whose value is the stop's `by`."""
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
    """Whether a person at the robot switched the motors off, or holds them off."""
    return stop.by in (Hand.MOTORS, Hand.BUTTON)


def remedy(stop: Stop, *, motors: bool = True) -> str:
    """What has to be done at the robot before a stop can be released; empty if nothing has.

    `motors` is whether the motors are on, as far as the robot reports.
    """
    hand = next((hand for hand in Hand if hand == stop.by), None)
    if hand is not None and not (keeps_motors_off(stop) and motors):
        return hand.remedy
    return "" if motors else Hand.MOTORS.remedy


def release(stop: Stop, *, motors: bool = True) -> str:
    """What releases a stop, and what has to be done at the robot before, for people."""
    first = remedy(stop, motors=motors)
    return f"{first}, then `armadico resume`" if first else RESUME
