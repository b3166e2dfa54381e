"""First-party detectors: one module for each."""
