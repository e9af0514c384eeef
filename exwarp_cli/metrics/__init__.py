"""The metrics of images and of sequences."""
