//! The hands that are compiled in.
