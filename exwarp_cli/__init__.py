"""ExWarp: four output frames for every rendered one, from motion vectors and G-buffers."""

import os

__version__ = "0.2.0"

# onnxruntime 1.29 and later writes a device id and a database under the home folder as soon as it
# is imported, and looks up a telemetry host 20 s later. It reads this variable once, at its import.
# Every process that runs a network imports this package first: commands, workers and trainings.
os.environ["ORT_DISABLE_TELEMETRY"] = "1"
