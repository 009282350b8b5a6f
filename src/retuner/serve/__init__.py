"""The page: a process of its own that shows what sessions write, and puts people's orders where sessions look for them.

Nothing here is imported by a session, and no session waits for anything here: it reads live files and ledgers, and
writes order files. Killing, flooding or hanging it changes neither samples nor decisions.
"""
