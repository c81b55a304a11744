"""Controllers and safety filters that are called sample by sample, in a loop of one's own."""
