"""Rehearsals: what a running society would do, driven under a virtual clock before it is asked."""
