//! Durations of loading a network and of running it on a frame: `GRASPD_MODEL=model.onnx cargo bench -p graspd-inference`.
//!
//! Without a model the small ones of the tests are run, which says how long layers take that have nothing to do.

use std::sync::LazyLock;

use divan::{Bencher, black_box};
use graspd_inference::Network;

fn main() {
    divan::main();
}

static MODEL: LazyLock<Vec<u8>> = LazyLock::new(|| match std::env::var_os("GRASPD_MODEL") {
    Some(path) => std::fs::read(path).expect("a readable model"),
    None => include_bytes!("../tests/models/ours-tsdf-quaternion.onnx").to_vec(),
});

#[divan::bench]
fn load(bencher: Bencher) {
    bencher.bench(|| Network::from_bytes(black_box(&MODEL)).map(|n| n.info().side));
}

#[divan::bench(args = [1, 2])]
fn run(bencher: Bencher, threads: usize) {
    let network = Network::from_bytes(&MODEL).expect("a model");
    let volume = vec![0.5; network.info().side.pow(3)];
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
    bencher.bench(|| pool.install(|| network.run(black_box(&volume))));
}
