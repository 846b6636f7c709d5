"""Attacks on a running society by a hand-written peer, and what each one did."""
