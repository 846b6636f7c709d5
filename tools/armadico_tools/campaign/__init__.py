"""Campaigns: series of runs on a cluster, what is known of them, and learning from them.

Nothing else imports this folder. It is found by its entry points, and can be left out with them.
"""
