//! The space that arms share: who is where, and until when that is believed.
//!
//! A lease is granted where no other is in conflict. It expires when its arm shows no life in time; expired it is not
//! given away: the arm may stand in it. It is *doubtful* until somebody knows that the arm has left.

use std::sync::Arc;
use std::time::Duration;

use graspd_assign::{Capsule, Occupied, Swept};
use tokio::time::Instant;

/// What an arm holds.
#[derive(Debug, Clone)]
pub struct Lease {
    holder: usize,
    space: Arc<Swept>,
    until: Instant,
    doubtful: bool,
}

/// Why space is not given.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("arm {holder} is there")]
pub struct InConflict {
    /// Index of the arm that is in the way.
    pub holder: usize,
}

/// The shared space. Times are handed in.
#[derive(Debug, Clone)]
pub struct Space {
    clearance_m: f64,
    length: Duration,
    /// Where each arm stands when it is at home or over its bins: always its own.
    ground: Vec<Arc<Swept>>,
    leases: Vec<Lease>,
}

impl Space {
    /// Space in which each arm has its own ground.
    ///
    /// # Errors
    /// The two arms whose grounds are in conflict.
    pub fn new(ground: Vec<Arc<Swept>>, clearance_m: f64, length: Duration) -> Result<Self, (usize, usize)> {
        for a in 0..ground.len() {
            for b in 0..a {
                if ground[a].is_near(&ground[b], clearance_m) {
                    return Err((b, a));
                }
            }
        }
        Ok(Self { clearance_m, length, ground, leases: Vec::new() })
    }

    /// Reserves space for an arm, or says who is in the way. What the arm had before is given back only if it gets this.
    ///
    /// # Errors
    /// [`InConflict`].
    pub fn reserve(&mut self, holder: usize, space: Arc<Swept>, now: Instant) -> Result<(), InConflict> {
        let lease = self.leases.iter().filter(|l| l.holder != holder);
        let grounds = self.ground.iter().enumerate().filter(|(arm, _)| *arm != holder);
        let all = lease.map(|l| (l.holder, &l.space)).chain(grounds);
        for (other, theirs) in all {
            if space.is_near(theirs, self.clearance_m) {
                return Err(InConflict { holder: other });
            }
        }
        self.release(holder);
        self.leases.push(Lease { holder, space, until: now + self.length, doubtful: false });
        Ok(())
    }

    /// The arm has shown life: its lease goes on, unless it is in doubt.
    pub fn renew(&mut self, holder: usize, now: Instant) {
        for lease in self.leases.iter_mut().filter(|l| l.holder == holder && !l.doubtful) {
            lease.until = now + self.length;
        }
    }

    /// The arm is known to have left.
    pub fn release(&mut self, holder: usize) {
        self.leases.retain(|l| l.holder != holder);
    }

    /// Nobody knows where the arm is: what it holds stays closed until it is released.
    pub fn doubt(&mut self, holder: usize) {
        for lease in self.leases.iter_mut().filter(|l| l.holder == holder) {
            lease.doubtful = true;
        }
    }

    /// Arms whose leases have expired by now; their space is in doubt from here on.
    pub fn expire(&mut self, now: Instant) -> Vec<usize> {
        let over = self.leases.iter_mut().filter(|l| !l.doubtful && l.until <= now);
        over.map(|lease| {
            lease.doubtful = true;
            lease.holder
        })
        .collect()
    }

    /// True while an arm holds space.
    pub fn holds(&self, holder: usize) -> bool {
        self.leases.iter().any(|l| l.holder == holder)
    }

    /// The space that an arm holds besides its ground.
    pub fn held(&self, holder: usize) -> Vec<Capsule> {
        let leases = self.leases.iter().filter(|l| l.holder == holder);
        leases.flat_map(|l| l.space.capsules().iter().copied()).collect()
    }

    /// When the next lease expires.
    pub fn next_expiry(&self) -> Option<Instant> {
        self.leases.iter().filter(|l| !l.doubtful).map(|l| l.until).min()
    }

    /// What is in the way of an arm that is free: leases and grounds of others.
    pub fn occupied(&self, names: &[String], free: &[usize]) -> Vec<Occupied> {
        let name = |arm: usize| names.get(arm).cloned().unwrap_or_default();
        let leases = self.leases.iter().map(|l| (l.holder, &l.space));
        // The ground of a free arm is in the way of the other free arms: each is judged against it by itself.
        let grounds = self.ground.iter().enumerate().filter(|(arm, _)| !free.contains(arm));
        leases.chain(grounds).map(|(arm, c)| Occupied { by: name(arm), space: c.clone() }).collect()
    }

    /// Who stands in the way of this corridor at home: another arm's ground.
    pub fn ground_in_way(&self, holder: usize, space: &Swept) -> Option<usize> {
        let others = self.ground.iter().enumerate().filter(|(arm, _)| *arm != holder);
        others.into_iter().find(|(_, g)| space.is_near(g, self.clearance_m)).map(|(arm, _)| arm)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use proptest::prelude::*;

    fn ball(x: f64, radius_m: f64) -> Arc<Swept> {
        let at = Point3::new(x, 0.0, 0.0);
        Arc::new(Swept::new(vec![Capsule { a: at, b: at, radius_m }]))
    }

    #[test]
    fn grounds_must_be_apart() {
        let (near, far) = (vec![ball(0.0, 0.3), ball(0.5, 0.3)], vec![ball(0.0, 0.2), ball(0.5, 0.2)]);
        assert_eq!(Space::new(near, 0.02, Duration::from_secs(1)).err(), Some((0, 1)));
        assert!(Space::new(far, 0.02, Duration::from_secs(1)).is_ok());
    }

    #[test]
    fn an_expired_lease_stays_closed_until_the_arm_is_known_to_have_left() {
        let mut space =
            Space::new(vec![ball(-9.0, 0.1), ball(9.0, 0.1)], 0.0, Duration::from_secs(10)).unwrap();
        let now = Instant::now();
        let after = |s| now + Duration::from_secs(s);
        space.reserve(0, ball(0.0, 0.2), now).unwrap();
        space.renew(0, after(5));
        assert!(space.expire(after(14)).is_empty());
        assert_eq!(space.expire(after(15)), [0]);
        assert_eq!(space.expire(after(16)), [0usize; 0], "told once");
        assert_eq!(space.reserve(1, ball(0.3, 0.2), after(99)), Err(InConflict { holder: 0 }));
        space.renew(0, after(99));
        assert_eq!(space.next_expiry(), None, "what is in doubt stays so");
        space.release(0);
        space.reserve(1, ball(0.3, 0.2), after(99)).unwrap();
        assert_eq!(space.reserve(0, ball(9.0, 0.2), after(99)), Err(InConflict { holder: 1 }));
    }

    proptest! {
        /// Whatever is asked for in whatever order, no two arms ever hold space that overlaps.
        #[test]
        fn nobody_is_where_another_is(asked in prop::collection::vec((0..4usize, -1.0..1.0f64, 0.05..0.5f64, any::<bool>()), 0..60)) {
            let ground = (0..4).map(|i| ball(10.0 + 3.0 * f64::from(i), 0.5)).collect();
            let mut space = Space::new(ground, 0.01, Duration::from_secs(5)).unwrap();
            let mut now = Instant::now();
            for (arm, x, radius, leave) in asked {
                now += Duration::from_secs(1);
                let _expired = space.expire(now);
                if leave { space.release(arm) } else { let _refused = space.reserve(arm, ball(x, radius), now); }
                for a in &space.leases {
                    for b in space.leases.iter().filter(|b| b.holder != a.holder) {
                        prop_assert!(!a.space.is_near(&b.space, 0.01));
                    }
                }
            }
        }
    }
}
