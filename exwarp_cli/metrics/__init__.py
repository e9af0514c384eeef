"""Image quality metrics in one registry."""
