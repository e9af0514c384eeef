"""Networks and policies in files. The only user of onnxruntime."""
