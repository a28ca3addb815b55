"""How fast kvision is, beside the speed of memory and beside its peers: `python -m benchmarks --help`, README.md."""
