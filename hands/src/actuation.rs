//! How few coordinates move many joints: `q = A·u + b`.
//!
//! A two-finger gripper with one motor has one coordinate, not two joints and a penalty that asks them to
//! agree. Coordinates are what the optimizer moves: the *actuators* that a controller commands, and, for
//! underactuated fingers, *adaptive* coordinates that follow the object. What an adaptive mechanism
//! prefers but does not force is a [`SoftCoupling`].

/// Who moves a coordinate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CoordinateKind {
    /// A motor: the controller commands it.
    Actuator,
    /// A free joint of an underactuated finger: contact decides it.
    Adaptive,
}

/// One generalized coordinate of a hand.
#[derive(Debug, Clone, PartialEq)]
pub struct Coordinate {
    /// Name: the actuator's, or the adaptive joint's.
    pub name: String,
    /// Actuator or adaptive.
    pub kind: CoordinateKind,
    /// Lower limit such that every joint that depends on this coordinate keeps its own limits.
    pub lower: f64,
    /// Upper limit, likewise.
    pub upper: f64,
    /// Value with the hand open (where initialization starts, Supplementary Note 4).
    pub open: f64,
    /// Value towards which the coordinate closes; equal to `open` for one that does not close (a spread).
    pub closed: f64,
    /// Largest effort of the actuator (newton metres or newtons); 0 when unknown.
    pub effort: f64,
}

/// One joint as a linear function of the coordinates: `q = Σ coefficient·u[index] + offset`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct JointRow {
    /// Non-zero entries: (coordinate index, coefficient).
    pub terms: Vec<(usize, f64)>,
    /// Constant part.
    pub offset: f64,
}

/// A preference among joints: `Σ coefficient·q[index] → target`, penalized, not forced.
#[derive(Debug, Clone, PartialEq)]
pub struct SoftCoupling {
    /// (joint index, coefficient).
    pub terms: Vec<(usize, f64)>,
    /// Value that the sum should take.
    pub target: f64,
    /// Relative weight; the objective's own weight multiplies it.
    pub weight: f64,
}

/// The map from coordinates to joints, and the soft preferences.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Actuation {
    /// Coordinates; this order is the order of every coordinate vector.
    pub coordinates: Vec<Coordinate>,
    /// One row per joint, in the order of the tree's joints.
    pub rows: Vec<JointRow>,
    /// Preferences of adaptive mechanisms.
    pub couplings: Vec<SoftCoupling>,
}

impl Actuation {
    /// Joint positions for coordinates `u`, written into `q`.
    ///
    /// # Panics
    /// If a length does not fit.
    pub fn joints_into(&self, u: &[f64], q: &mut [f64]) {
        assert_eq!(u.len(), self.coordinates.len(), "one value per coordinate");
        assert_eq!(q.len(), self.rows.len(), "one slot per joint");
        for (slot, row) in q.iter_mut().zip(&self.rows) {
            *slot = row.terms.iter().fold(row.offset, |sum, &(i, c)| sum + c * u[i]);
        }
    }

    /// Joint positions for coordinates `u`.
    pub fn joints(&self, u: &[f64]) -> Vec<f64> {
        let mut q = vec![0.0; self.rows.len()];
        self.joints_into(u, &mut q);
        q
    }

    /// Carries a gradient with respect to joints back to coordinates, `Aᵀ·g`, written into `out`.
    pub fn pull_back(&self, joint_gradient: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        for (g, row) in joint_gradient.iter().zip(&self.rows) {
            for &(i, c) in &row.terms {
                out[i] += c * g;
            }
        }
    }

    /// Number of actuators (coordinates that a controller commands).
    pub fn actuator_count(&self) -> usize {
        self.coordinates.iter().filter(|c| c.kind == CoordinateKind::Actuator).count()
    }

    /// The open posture.
    pub fn open(&self) -> Vec<f64> {
        self.coordinates.iter().map(|c| c.open).collect()
    }

    /// The closed posture.
    pub fn closed(&self) -> Vec<f64> {
        self.coordinates.iter().map(|c| c.closed).collect()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::library;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        /// The gradient carried back is the transpose: it agrees with differences of the map itself.
        #[test]
        fn pull_back_is_the_transpose(which in any::<prop::sample::Index>(), seed in prop::collection::vec(-1.0..1.0_f64, 64)) {
            let actuation = &library::hand(library::ids()[which.index(library::ids().len())]).unwrap().actuation;
            let (n, m) = (actuation.coordinates.len(), actuation.rows.len());
            let (u, du, g) = (&seed[..n], &seed[20..20 + n], &seed[40..40 + m]);
            let moved: Vec<f64> = u.iter().zip(du).map(|(a, b)| a + b).collect();
            let (before, after) = (actuation.joints(u), actuation.joints(&moved));
            let forward: f64 = g.iter().zip(after.iter().zip(&before)).map(|(g, (a, b))| g * (a - b)).sum();
            let mut back = vec![0.0; n];
            actuation.pull_back(g, &mut back);
            let backward: f64 = back.iter().zip(du).map(|(a, b)| a * b).sum();
            prop_assert!((forward - backward).abs() < 1e-9);
        }

        /// Inside the coordinates' limits every joint keeps its own.
        #[test]
        fn coordinate_limits_keep_joint_limits(which in any::<prop::sample::Index>(), at in prop::collection::vec(0.0..=1.0_f64, 16)) {
            let hand = library::hand(library::ids()[which.index(library::ids().len())]).unwrap();
            let u: Vec<f64> = hand.actuation.coordinates.iter().zip(&at).map(|(c, t)| c.lower + t * (c.upper - c.lower)).collect();
            for (q, joint) in hand.actuation.joints(&u).iter().zip(&hand.tree.joints) {
                prop_assert!(*q >= joint.lower - 1e-4 && *q <= joint.upper + 1e-4, "{} of {}", joint.name, hand.id);
            }
        }
    }
}
