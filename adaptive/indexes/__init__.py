"""The classic indexes of loop assessment, one a file, and the screening that collects them.

They describe a record in the words that engineers know and give the evidence of a diagnosis; they do not decide where
fitted hypotheses can. Each is a pure function of arrays; None means that the index does not apply to this record.
"""
