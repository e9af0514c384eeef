"""The predictor's accelerator as an integer specification (paper, section IV-C).

`mlp` defines the arithmetic, `mac_array` the machine.
"""
