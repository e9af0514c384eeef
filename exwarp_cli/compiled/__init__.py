"""How numba compiles what it does here, and where that is kept from run to run."""
