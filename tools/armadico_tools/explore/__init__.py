"""Every run of the real coordination, up to so many faults: no model of it, and no random numbers.

`world` holds real contenders and a real owner, and the messages under way between them; each cycle
is one step, and whatever could go otherwise is picked from outside. `identity` decides which worlds
are the same from here on, `search` explores all of them, `recovery` finds what never comes right
again, and `replay` has one run, runs it again and prints it as a test. `joining` is the world of
instances that are being admitted.
"""
