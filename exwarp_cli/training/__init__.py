"""Learning from rendered scenes."""
