"""Frozen data types and enumerations that every layer above shares."""
