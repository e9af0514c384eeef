import exwarp_cli  # noqa: F401  before any test imports onnxruntime, whose telemetry it stops
