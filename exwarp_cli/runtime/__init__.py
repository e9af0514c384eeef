"""The process: its memory, its stops, and what it reads."""
