"""The predictor in Verilog, simulated and synthesised."""
