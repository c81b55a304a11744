"""Text on the screen: summaries, values, equations, derivations."""
