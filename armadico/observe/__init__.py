"""Observers of a society: state, explanations, diagnosis, measures, audits."""
