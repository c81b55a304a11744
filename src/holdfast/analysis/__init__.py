"""What follows from running things: results with names and units, and their statistics."""
