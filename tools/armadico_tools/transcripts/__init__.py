"""Check an agent, in any language, against files, without mesh, clock or robot.

`docs/transcripts/*.jsonl` were recorded on the virtual mesh. Each has all that the agents of a
scene received and published, with times. They are fixtures, like recordings of other clients: an
agent that decides differently fails them, and so does another protocol. The program that recorded
them, with protocol 2, is in the history, at 266daee4. Protocol 3 changed their keys and cards, and
no decision.
"""
