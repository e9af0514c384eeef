"""A command's work without its options."""
