"""The predictor's design in Verilog-2005; `exwarp policy export DIR --verilog` writes it."""
