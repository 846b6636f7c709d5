"""What runs agents in one process, and what a guest of the mesh needs."""
