"""Sets that inputs and disturbances live in: one class, one file; each answers for itself."""
