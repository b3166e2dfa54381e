"""First-party fusers: one module for each."""
