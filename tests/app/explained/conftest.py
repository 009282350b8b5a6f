"""Makes decision_documents.py importable from the tests beside it."""
