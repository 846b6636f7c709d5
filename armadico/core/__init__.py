"""Coordination, sans-IO: messages and the time in, messages out. No socket, thread or clock."""
