"""Robots with a laser explore with slam, unless their sensors are ideal."""

from armadico.config.slots import Slot

SLAM = Slot(without=("localization", "relocate", "mapping"), besides=("slam",))
