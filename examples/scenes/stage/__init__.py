"""What all scenes share: materials, meshes, motion, and rendering into a data set."""
