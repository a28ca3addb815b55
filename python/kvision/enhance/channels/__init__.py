"""Operators that change every channel by itself."""
