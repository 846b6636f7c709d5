"""Running agents in one process, and a guest's client of the mesh."""
