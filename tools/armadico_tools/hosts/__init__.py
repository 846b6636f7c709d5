"""Several hosts on one machine: network namespaces, the links between them, containers."""
