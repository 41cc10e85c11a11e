"""Models for others: ONNX, graphs, repositories."""
