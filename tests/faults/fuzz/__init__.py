"""Shots that are damaged in every way that is known, and commands that read them."""
