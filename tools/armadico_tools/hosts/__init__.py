"""Several machines on this one: hosts, the links between them, and what can be shown with them."""
