"""First-party executors, a module each."""
