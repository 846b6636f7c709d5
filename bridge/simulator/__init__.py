"""A simulated Pioneer: dynamics, sensors and the controller that speaks P2OS."""
