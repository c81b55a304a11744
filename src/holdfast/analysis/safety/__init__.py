"""Safety filters from value functions, closed-loop validation of sets, gains for visibility."""
