"""Tables of a file to definitions: one module for each table."""
