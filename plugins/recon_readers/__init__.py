"""First-party readers: one module for each format."""
