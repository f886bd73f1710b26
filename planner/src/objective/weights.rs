//! The weight of every objective, in one place, with its source.

/// Weights and constants of `O_overall`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weights {
    /// Contact distance, per metre.
    pub contact_distance: f64,
    /// Certainty ascent; a candidate without any certainty costs [`Self::certainty_length_m`].
    pub certainty: f64,
    /// Length that turns certainty (0 to 1) into metres.
    pub certainty_length_m: f64,
    /// Orientation match (each candidate 0 to 1).
    pub orientation: f64,
    /// Centroid, per metre.
    pub centroid: f64,
    /// Linear independence.
    pub independence: f64,
    /// Smallest eigenvalue of the normalized grasp matrix that costs nothing.
    pub independence_floor: f64,
    /// Net wrench.
    pub net_wrench: f64,
    /// Length that turns torques into forces, metres.
    pub characteristic_length_m: f64,
    /// Approach, `b_ab`.
    pub approach: f64,
    /// Joint limits, per radian or metre.
    pub joint_limits: f64,
    /// Soft couplings, per radian or metre.
    pub coupling: f64,
    /// Penetration, per metre of depth of a sphere.
    pub penetration: f64,
}

impl Weights {
    /// The weights of the reference implementation (1, 1, 1, 10, 1, 0.01, 0.1, 1, 10, 100).
    ///
    /// Two constants differ by construction: torques are scaled by a characteristic length (the reference
    /// leaves metres, which makes them negligible), and penetration is metres of depth over the spheres of
    /// the whole hand instead of the share of contact points that point inwards.
    pub fn reference() -> Self {
        Self {
            contact_distance: 1.0,
            certainty: 1.0,
            certainty_length_m: 0.01,
            orientation: 1.0,
            centroid: 10.0,
            independence: 1.0,
            independence_floor: 0.01,
            net_wrench: 0.01,
            characteristic_length_m: 0.05,
            approach: 0.1,
            joint_limits: 1.0,
            coupling: 10.0,
            penetration: 100.0,
        }
    }
}

impl Default for Weights {
    /// The reference's weights but for two, which were chosen on eight real frames and four hands by the
    /// share of candidates that pass every check of the ranking: orientation 0.3 (its gradient here also
    /// moves positions, which the reference's does not, and at 1 it drowns the distance to contacts) and net
    /// wrench 0.1 (torques count here).
    fn default() -> Self {
        Self { orientation: 0.3, net_wrench: 0.1, ..Self::reference() }
    }
}
