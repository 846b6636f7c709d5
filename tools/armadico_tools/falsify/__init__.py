"""A search for contacts that the robot's sensors could have prevented, whoever holds the wheels."""
