"""Training of graspd's contact network: data in, ONNX file out."""

__version__ = "0.1.0"
