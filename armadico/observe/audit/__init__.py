"""The auditor: whether a society keeps its promises, judged by its messages alone.

One pure class (`auditor.Auditor`) for the fault bed, for recordings, live and in the monitor. Each
promise has a rule; each excuse of a rule has a name, and can be switched off.
"""
