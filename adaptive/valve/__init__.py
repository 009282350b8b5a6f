"""The valve between the output and the process: sticking and play, as an explanation of a record or of a step.

Who decides by them: diagnosis/diagnose.py of one record by itself; off line the last word is cause_odds/odds.py's, on
line that of supervision/confirmation.py.
"""
