//! The observed volume: what depth frames say about each voxel.
