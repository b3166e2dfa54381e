"""First-party aligners: one module for each."""
