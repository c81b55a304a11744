"""One arithmetic for every target: steps of IEEE 754 operations, and the functions made of them."""
