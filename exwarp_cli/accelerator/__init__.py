"""The predictor's accelerator as an integer specification (paper, section IV-C).

`fixed_point` and `mlp` define the arithmetic, `mac_array` the machine.
"""
