"""Numba kernels: arrays in, arrays out; they raise nothing and know no frames."""
