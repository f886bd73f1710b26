//! Mock devices in a shared world: what they promise, and every fault as the caller sees it.

mod arm;
mod camera;
#[cfg(test)]
mod fixtures;
mod hand;
mod world;
