"""The robot: its controller's protocol, the agent that owns the port, and the simulator."""
