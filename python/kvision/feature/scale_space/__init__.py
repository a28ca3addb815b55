"""Peaks of scale spaces, and features from them."""
