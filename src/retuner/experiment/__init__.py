"""An experiment on demand: conducted against a controller, evaluated, shown, and its settings offered."""
