"""Trial and undo: what a change promises, how it is judged, and the way back."""
