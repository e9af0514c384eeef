"""Research: trainings and benchmarks, which only their commands import."""
