"""The version of this client: that of the repository it came from."""

__version__ = "0.1.0"
