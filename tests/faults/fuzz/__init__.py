"""Shots that are damaged in every way that somebody thought of, and commands that read them."""
