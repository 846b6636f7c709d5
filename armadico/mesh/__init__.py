"""The meshes: `zenoh` between processes, `virtual` in one thread under a virtual clock."""
