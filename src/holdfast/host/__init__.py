"""The machine around a program: standard streams, interruption, files that are read and written."""
