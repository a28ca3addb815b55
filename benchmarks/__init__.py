"""Benchmarks of kvision against memory bandwidth and other libraries: `python -m benchmarks --help`, README.md."""
