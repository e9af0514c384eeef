"""The predictor's accelerator as an integer specification (paper, section IV-C).

`fixed_point` and `quantised_mlp` define the arithmetic, `mac_array` and `simulation` the machine;
they need numpy only. `kernel` compiles the same arithmetic with numba.
"""
