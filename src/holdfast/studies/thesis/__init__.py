"""Claims of the thesis as data, their verdicts, and the report."""
