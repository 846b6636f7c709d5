"""Check an agent, in any language, against files: no mesh, no clock and no robot are needed.

`docs/transcripts/*.jsonl` were recorded on the virtual mesh with protocol 2. Each has all that the
agents of a scene received, when, and all that they published. They are fixtures, as recordings of
other clients are: an agent that decides otherwise breaks them, and so does another protocol. The
program that recorded them is in the history, at 266daee4.
"""
