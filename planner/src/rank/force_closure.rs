//! Force-closure margin of a set of contacts with Coulomb friction (Ferrari and Canny 1992, L1 budget).
//!
//! The margin is the radius of the largest ball about the origin inside the convex hull of all wrenches
//! that contacts of unit normal force can exert. The hull's support function has a closed form for round
//! friction cones, so no cone is approximated by edges; the radius is the smallest support over unit
//! directions, searched from fixed directions and refined downhill. Each value found is an upper bound.

use std::sync::Arc;

use nalgebra::{Vector3, Vector6};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;

/// Directions that the search starts with.
const DIRECTIONS: usize = 192;
/// How many of the worst directions are refined.
const REFINED: usize = 6;
/// Downhill steps for each.
const STEPS: usize = 24;

/// A contact: its position relative to the grasp's centre, and the inward normal.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Push {
    pub(crate) arm: Vector3<f64>,
    pub(crate) inward: Vector3<f64>,
}

/// The fixed directions of the search; made once per ranking, cheap to clone.
#[derive(Debug, Clone)]
pub(crate) struct Directions(Arc<[Vector6<f64>]>);

impl Directions {
    pub(crate) fn new() -> Self {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(0x6772_6173);
        let mut all: Vec<Vector6<f64>> =
            (0..6).flat_map(|k| [Vector6::ith(k, 1.0), Vector6::ith(k, -1.0)]).collect();
        while all.len() < DIRECTIONS {
            let v = Vector6::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal));
            if v.norm() > 1e-3 {
                all.push(v.normalize());
            }
        }
        Self(all.into())
    }
}

/// Support of the wrench hull in a direction, and the wrench that attains it.
fn support(pushes: &[Push], friction: f64, length: f64, direction: &Vector6<f64>) -> (f64, Vector6<f64>) {
    let force = Vector3::new(direction[0], direction[1], direction[2]);
    let torque = Vector3::new(direction[3], direction[4], direction[5]) / length;
    let mut best = (f64::NEG_INFINITY, Vector6::zeros());
    for p in pushes {
        // d·(f, r×f/ℓ) = f·(d_f + d_τ × r / ℓ)
        let g = force + torque.cross(&p.arm);
        let along = g.dot(&p.inward);
        let side = g - p.inward * along;
        let slide = side.norm();
        let value = along + friction * slide;
        if value > best.0 {
            let f = if slide > 1e-12 { p.inward + side * (friction / slide) } else { p.inward };
            let t = p.arm.cross(&f) / length;
            best = (value, Vector6::new(f.x, f.y, f.z, t.x, t.y, t.z));
        }
    }
    best
}

/// The Ferrari-Canny margin, per newton of normal force; 0 where there is no force closure.
///
/// `length` divides torques (the object's size), so that the margin has no scale.
pub(crate) fn margin(pushes: &[Push], friction: f64, length: f64, directions: &Directions) -> f64 {
    if pushes.len() < 2 {
        return 0.0;
    }
    let mut starts: Vec<(f64, Vector6<f64>)> =
        directions.0.iter().map(|d| (support(pushes, friction, length, d).0, *d)).collect();
    // The direction away from the mean wrench is the likeliest gap.
    let mean: Vector6<f64> =
        pushes.iter().map(|p| support(std::slice::from_ref(p), 0.0, length, &Vector6::zeros()).1).sum();
    if mean.norm() > 1e-9 {
        let away = -mean.normalize();
        starts.push((support(pushes, friction, length, &away).0, away));
    }
    starts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut smallest = starts[0].0;
    for (_, start) in starts.iter().take(REFINED) {
        let mut d = *start;
        let mut pace = 0.3;
        let (mut value, mut wrench) = support(pushes, friction, length, &d);
        for _ in 0..STEPS {
            let slope = wrench - d * value;
            let norm = slope.norm();
            if norm < 1e-9 {
                break;
            }
            let next = (d - slope * (pace / norm)).normalize();
            let (v, w) = support(pushes, friction, length, &next);
            if v < value {
                (d, value, wrench) = (next, v, w);
            } else {
                pace *= 0.5;
            }
        }
        smallest = smallest.min(value);
        if smallest <= 0.0 {
            return 0.0;
        }
    }
    smallest.max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(count: usize, radius: f64) -> Vec<Push> {
        (0..count)
            .map(|i| {
                let a = i as f64 / count as f64 * std::f64::consts::TAU;
                let out = Vector3::new(a.cos(), a.sin(), 0.0);
                Push { arm: out * radius, inward: -out }
            })
            .collect()
    }

    #[test]
    fn three_contacts_around_a_disc_close_with_friction_only() {
        let directions = Directions::new();
        let pushes = ring(3, 0.03);
        assert_eq!(margin(&pushes, 0.0, 0.03, &directions), 0.0);
        let weak = margin(&pushes, 0.3, 0.03, &directions);
        let strong = margin(&pushes, 0.8, 0.03, &directions);
        assert!(weak > 0.01 && strong > weak, "{weak} {strong}");
    }

    #[test]
    fn two_point_contacts_cannot_hold_a_twist_about_their_line() {
        let pushes = ring(2, 0.03);
        assert!(margin(&pushes, 0.8, 0.03, &Directions::new()) < 5e-3);
    }

    #[test]
    fn contacts_on_one_side_do_not_close() {
        let mut pushes = ring(8, 0.03);
        pushes.truncate(3);
        assert_eq!(margin(&pushes, 0.5, 0.03, &Directions::new()), 0.0);
    }

    /// With unit forces along ±x, ±y, ±z and no lever, the force part of the hull is the octahedron.
    #[test]
    fn the_margin_of_an_octahedron_with_torques_is_known() {
        let mut pushes = Vec::new();
        for k in 0..3 {
            for s in [-1.0, 1.0] {
                let mut inward = Vector3::zeros();
                inward[k] = s;
                for arm_axis in 0..3 {
                    for t in [-1.0, 1.0] {
                        let mut arm = Vector3::zeros();
                        arm[arm_axis] = t;
                        pushes.push(Push { arm, inward });
                    }
                }
            }
        }
        // Wrenches (±e_k, arm × e_k): in direction (f, τ) the support is max_k |f_k| + max_{j≠k} |τ_j|. Its least
        // over the unit sphere is 1/√3, for τ = 0 and three equal forces.
        let found = margin(&pushes, 0.0, 1.0, &Directions::new());
        let exact = 1.0 / 3.0_f64.sqrt();
        assert!(found >= exact - 1e-9, "an upper bound cannot be below {exact}, found {found}");
        assert!(found < exact * 1.1, "{found} is more than a tenth above {exact}");
    }
}
