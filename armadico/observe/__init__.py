"""Observers of a society: state, explanations, measures, recordings, pictures, dashboard."""
