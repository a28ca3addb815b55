"""Warps that average the pixels they shrink."""
