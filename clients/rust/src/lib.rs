//! A typed client of graspd with the documented retries.
