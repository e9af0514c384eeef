"""Research: benchmarks and training, which no other part of the package needs."""
