"""The live dashboard: one process that watches the mesh and the only one that imports rerun."""
