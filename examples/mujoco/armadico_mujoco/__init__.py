"""A robot in the MuJoCo physics simulator as a robot of Armadico."""
