"""The agent for driving by hand: no scenario lists it, and it is started on demand."""

from armadico.config.slots import Slot

BY_HAND = Slot(besides=("teleop",))
