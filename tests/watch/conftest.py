"""A small society for commands in a terminal."""

from tests.robot.terminal import environment, router, run, society

__all__ = ["environment", "router", "run", "society"]
