"""The iRobot Create 2 as a robot of Armadico."""
