"""The operating system: standard streams, interruption (SIGINT), reading and writing of files."""
