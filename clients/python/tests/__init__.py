"""Tests of the Python client: against a real server, and of what needs none."""
