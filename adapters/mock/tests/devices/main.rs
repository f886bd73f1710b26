//! Mock devices in a shared world: what they promise, and every fault as the caller sees it.

#[cfg(test)]
mod arm;
#[cfg(test)]
mod camera;
#[cfg(test)]
mod closing;
#[cfg(test)]
mod fixtures;
#[cfg(test)]
mod follow;
#[cfg(test)]
mod hand;
mod plants;
#[cfg(test)]
mod world;
