"""The live dashboard: an observer of the mesh, and the only package that imports rerun."""
