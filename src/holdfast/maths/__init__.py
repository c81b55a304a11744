"""What is true: systems, laws, regions and what follows from them symbolically. No arrays."""
