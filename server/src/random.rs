//! Numbers that nobody foresees.

use std::hash::{BuildHasher as _, RandomState};

use ring::rand::{SecureRandom as _, SystemRandom};

/// Random bytes.
pub(crate) fn bytes<const N: usize>() -> [u8; N] {
    let mut bytes = [0; N];
    if SystemRandom::new().fill(&mut bytes).is_err() {
        // No system without random numbers is known; names are unique all the same.
        for (i, chunk) in bytes.chunks_mut(8).enumerate() {
            let hash = RandomState::new().hash_one(i).to_ne_bytes();
            chunk.copy_from_slice(&hash[..chunk.len()]);
        }
    }
    bytes
}

/// A number from 0 to 1, 1 excluded.
pub(crate) fn unit() -> f64 {
    (u64::from_ne_bytes(bytes()) >> 11) as f64 / (1u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_differ_and_are_spread() {
        assert_ne!(bytes::<10>(), bytes::<10>());
        let mean = (0..4000).map(|_| unit()).sum::<f64>() / 4000.0;
        assert!((0.45..0.55).contains(&mean), "{mean}");
    }
}
