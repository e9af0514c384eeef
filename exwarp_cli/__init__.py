"""ExWarp: four output frames for every rendered one, from motion vectors and G-buffers."""

__version__ = "0.1.0"
