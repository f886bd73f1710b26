//! End-to-end tests of graspd over real sockets.
