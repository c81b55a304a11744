"""What is seen: figures and text. Reads results, computes nothing new."""
