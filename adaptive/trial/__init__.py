"""Trial and rollback: what a change promises, how it is judged, and the way back."""
