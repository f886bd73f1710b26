//! Duration of loading and running a network of the size that graspd ships, weights at random.

use std::sync::LazyLock;

use divan::{Bencher, black_box};
use graspd_inference::Network;

fn main() {
    divan::main();
}
