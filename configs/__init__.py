"""What is shipped: robots, worlds, scenarios, hosts."""
