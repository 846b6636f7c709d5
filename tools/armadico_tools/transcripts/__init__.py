"""What a small society publishes, message by message, as files to check any agent against.

`docs/transcripts/*.jsonl` are written by the virtual mesh from a fixed seed. Each has all that its
agents received, when, and all that they published. So whoever writes an agent, in whatever
language, gives it the one and compares the other: no mesh, no clock and no robot are needed.
"""
