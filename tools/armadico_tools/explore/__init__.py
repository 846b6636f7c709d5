"""Every run of the real coordination, up to so many faults: no model of it, and no dice.

`world` holds real contenders and a real owner, and the messages under way between them; each cycle
is one step, and whatever could go otherwise is picked from outside. `identity` decides which worlds
are the same from here on, `search` goes through all of them, `recovery` looks for what never comes
right again, `replay` runs one again, and `testing` prints it as a test. `joining` is the same for
who may join.
"""
