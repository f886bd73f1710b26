//! The graspd gRPC service: wire and domain conversion, planning pool, hand registry.
