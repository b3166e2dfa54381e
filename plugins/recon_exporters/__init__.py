"""First-party exporters: one module for each."""
