"""First-party integrators: one module for each."""
