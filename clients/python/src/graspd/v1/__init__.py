"""The messages and services of the package graspd.v1, generated from the protocol's files."""
