"""What a set is good for: safety filters over it, validation in closed loop, gains."""
