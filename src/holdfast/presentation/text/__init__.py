"""Text for the terminal: summaries, values, equations, derivations."""
