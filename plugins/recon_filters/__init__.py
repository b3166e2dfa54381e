"""First-party filters: one module for each."""
