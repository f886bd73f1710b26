//! Weighted choices, and the seeded numbers that make them.

use std::str::FromStr;

/// A seeded number for one choice of one call: the same for the same seed, whatever happens in between.
#[derive(Debug, Clone, Copy)]
pub(super) struct Draw(u64);

impl Draw {
    /// Choice `which` of call `number` (SplitMix64).
    pub(super) fn of(seed: u64, number: u64, which: u64) -> Self {
        let mut z = seed
            .wrapping_mul(0xd134_2543_de82_ef95)
            .wrapping_add(number.wrapping_mul(0x9e37_79b9_7f4a_7c15))
            .wrapping_add(which.wrapping_mul(0xbf58_476d_1ce4_e5b9))
            .wrapping_add(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        Self(z ^ (z >> 31))
    }

    /// From 0 up to but not 1.
    pub(super) fn share(self) -> f64 {
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Names with weights: `a=3,b`.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Mix(Vec<(String, f64)>);

impl Mix {
    /// The names.
    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(|(name, _)| name.as_str())
    }

    /// Which of the names a draw falls on.
    pub(super) fn pick(&self, draw: Draw) -> usize {
        let total: f64 = self.0.iter().map(|(_, weight)| weight).sum();
        let mut left = draw.share() * total;
        for (i, (_, weight)) in self.0.iter().enumerate() {
            left -= weight;
            if left < 0.0 {
                return i;
            }
        }
        self.0.len().saturating_sub(1)
    }
}

impl FromStr for Mix {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let part = |part: &str| {
            let (name, weight) = part.split_once('=').unwrap_or((part, "1"));
            let parsed = weight.trim().parse().ok().filter(|w: &f64| w.is_finite() && *w > 0.0);
            let weight =
                parsed.ok_or_else(|| format!("found weight {weight:?}, expected a number above 0"))?;
            match name.trim() {
                "" => Err("found a part without a name, expected for example a=3,b".to_owned()),
                name => Ok((name.to_owned(), weight)),
            }
        };
        text.split(',').map(part).collect::<Result<_, _>>().map(Self)
    }
}
