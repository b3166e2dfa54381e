"""First-party analyzers: one module for each question that is asked of a result."""
