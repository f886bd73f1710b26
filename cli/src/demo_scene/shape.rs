//! Signed distance functions of the demo scene's objects, in their own frames (origin at the bottom's
//! centre for what stands, metres).

use nalgebra::{Point3, Vector3};

/// What an object looks like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Shape {
    /// A carton with slightly rounded edges, standing on z = 0.
    Carton {
        /// Half extents.
        half: [f64; 3],
    },
    /// A can standing on z = 0.
    Can {
        /// Radius.
        radius: f64,
        /// Height.
        height: f64,
    },
    /// A ball touching z = 0.
    Ball {
        /// Radius.
        radius: f64,
    },
    /// A roll with round ends lying along x, touching z = 0.
    Roll {
        /// Radius.
        radius: f64,
        /// Half of the distance between the centres of its ends.
        half_length: f64,
    },
    /// A mug with a handle towards +x.
    Mug {
        /// Outer radius.
        radius: f64,
        /// Height.
        height: f64,
    },
    /// A bowl: the lower part of a spherical shell on a foot.
    Bowl {
        /// Outer radius of the rim's sphere.
        radius: f64,
    },
    /// A bottle: body, shoulder and neck.
    Bottle {
        /// Radius of the body.
        radius: f64,
        /// Height with the neck.
        height: f64,
    },
}

impl Shape {
    /// Signed distance at `p`, or a lower bound of its size: safe for sphere tracing.
    pub(crate) fn distance(&self, p: &Point3<f64>) -> f64 {
        match *self {
            Self::Carton { half } => {
                let edge = 0.003;
                let h = Vector3::new(half[0] - edge, half[1] - edge, half[2] - edge);
                cuboid(&(p - Point3::new(0.0, 0.0, half[2])), &h) - edge
            }
            Self::Can { radius, height } => {
                cylinder(&(p - Point3::new(0.0, 0.0, height / 2.0)), radius, height / 2.0)
            }
            Self::Ball { radius } => (p - Point3::new(0.0, 0.0, radius)).norm() - radius,
            Self::Roll { radius, half_length } => {
                let x = p.x.clamp(-half_length, half_length);
                (p - Point3::new(x, 0.0, radius)).norm() - radius
            }
            Self::Mug { radius, height } => {
                let wall = 0.004;
                let middle = p - Point3::new(0.0, 0.0, height / 2.0);
                let outer = cylinder(&middle, radius, height / 2.0);
                let inner = cylinder(&(middle - Vector3::z() * (2.0 * wall)), radius - wall, height / 2.0);
                let body = outer.max(-inner);
                // The handle: a ring in the x-z plane, thicker than the wall.
                let ring = p - Point3::new(radius + 0.006, 0.0, height * 0.5);
                let round = ring.x.hypot(ring.z) - height * 0.27;
                let handle = (round.hypot(ring.y) - 0.0055).max(radius - wall - p.x);
                body.min(handle)
            }
            Self::Bowl { radius } => {
                let wall = 0.004;
                let center = Point3::new(0.0, 0.0, radius * 0.95);
                let shell = ((p - center).norm() - (radius - wall / 2.0)).abs() - wall / 2.0;
                let rim = p.z - radius * 0.75;
                let foot = cylinder(&(p - Point3::new(0.0, 0.0, 0.005)), radius * 0.45, 0.005);
                shell.max(rim).min(foot)
            }
            Self::Bottle { radius, height } => {
                let body_top = height * 0.62;
                let body = cylinder(
                    &(p - Point3::new(0.0, 0.0, body_top / 2.0)),
                    radius - 0.006,
                    body_top / 2.0 - 0.006,
                ) - 0.006;
                let neck = cylinder(&(p - Point3::new(0.0, 0.0, height / 2.0)), radius * 0.42, height / 2.0);
                smooth_union(body, neck, 0.018)
            }
        }
    }

    /// Radius of a ball about the origin of the shape's frame that contains the shape.
    pub(crate) fn bound(&self) -> f64 {
        match *self {
            Self::Carton { half } => half[0].hypot(half[1]).hypot(2.0 * half[2]),
            Self::Can { radius, height } | Self::Bottle { radius, height } => radius.hypot(height),
            Self::Ball { radius } => 2.0 * radius,
            Self::Roll { radius, half_length } => (half_length + radius).hypot(2.0 * radius),
            Self::Mug { radius, height } => (radius + 0.012 + 0.27 * height).hypot(height),
            Self::Bowl { radius } => 1.5 * radius,
        }
    }
}

fn cuboid(p: &Vector3<f64>, half: &Vector3<f64>) -> f64 {
    let q = p.abs() - half;
    q.sup(&Vector3::zeros()).norm() + q.max().min(0.0)
}

fn cylinder(p: &Vector3<f64>, radius: f64, half_length: f64) -> f64 {
    let (side, cap) = (p.x.hypot(p.y) - radius, p.z.abs() - half_length);
    side.max(cap).min(0.0) + side.max(0.0).hypot(cap.max(0.0))
}

/// Polynomial smooth minimum: blends over `width`.
fn smooth_union(a: f64, b: f64, width: f64) -> f64 {
    let h = (width - (a - b).abs()).max(0.0) / width;
    a.min(b) - h * h * width * 0.25
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_at_known_points() {
        let can = Shape::Can { radius: 0.03, height: 0.1 };
        assert!((can.distance(&Point3::new(0.05, 0.0, 0.05)) - 0.02).abs() < 1e-12);
        assert!((can.distance(&Point3::new(0.0, 0.0, 0.13)) - 0.03).abs() < 1e-12);
        assert!(can.distance(&Point3::new(0.0, 0.0, 0.05)) < 0.0);
        let mug = Shape::Mug { radius: 0.04, height: 0.09 };
        assert!(mug.distance(&Point3::new(0.0, 0.0, 0.06)) > 0.02, "a mug is hollow");
        assert!(mug.distance(&Point3::new(0.038, 0.0, 0.06)) < 0.0, "and has a wall");
        let bowl = Shape::Bowl { radius: 0.06 };
        assert!(bowl.distance(&Point3::new(0.0, 0.0, 0.05)) > 0.03, "a bowl is hollow");
    }

    #[test]
    fn nothing_sticks_out_of_its_bound() {
        for placed in crate::demo_scene::objects::clutter() {
            let r = placed.shape.bound() * 1.05;
            for i in 0..40 {
                for k in 0..20 {
                    let (a, b) = (f64::from(i) * 0.157, f64::from(k) * 0.157);
                    let p = Point3::new(r * a.cos() * b.sin(), r * a.sin() * b.sin(), r * b.cos());
                    assert!(placed.shape.distance(&p) > 0.0, "{placed:?}");
                }
            }
        }
    }
}
