"""What decides between warping and extrapolating: features, states and policies."""
