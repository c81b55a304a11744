"""The keys of scenario files and their types (Pydantic)."""
