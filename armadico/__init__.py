"""Armadico: one robot, many agents, nobody in charge."""
