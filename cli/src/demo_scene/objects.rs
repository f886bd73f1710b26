//! What stands on the demo table: objects of 3 to 13 cm, close together, none inside another.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use super::shape::Shape;

/// A shape somewhere in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Placed {
    /// The shape.
    pub(crate) shape: Shape,
    /// Takes world coordinates to the shape's.
    pub(crate) shape_from_world: Isometry3<f64>,
    /// The shape's origin in the world.
    pub(crate) origin: Point3<f64>,
}

impl Placed {
    fn new(shape: Shape, x: f64, y: f64, yaw_deg: f64) -> Self {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_deg.to_radians());
        let world_from_shape = Isometry3::from_parts(Translation3::new(x, y, 0.0), rotation);
        Self { shape, shape_from_world: world_from_shape.inverse(), origin: Point3::new(x, y, 0.0) }
    }

    /// Signed distance at a point of the world, metres.
    pub(crate) fn distance(&self, p: &Point3<f64>) -> f64 {
        self.shape.distance(&(self.shape_from_world * p))
    }
}

/// The demo's clutter, world frame (origin in the middle of the table top, z up).
pub(crate) fn clutter() -> Vec<Placed> {
    vec![
        Placed::new(Shape::Carton { half: [0.024, 0.042, 0.055] }, -0.110, 0.095, 24.0),
        Placed::new(Shape::Can { radius: 0.033, height: 0.100 }, 0.005, 0.120, 0.0),
        Placed::new(Shape::Mug { radius: 0.039, height: 0.090 }, -0.085, -0.045, 205.0),
        Placed::new(Shape::Bowl { radius: 0.062 }, 0.110, -0.085, 0.0),
        Placed::new(Shape::Bottle { radius: 0.028, height: 0.150 }, 0.125, 0.095, 0.0),
        Placed::new(Shape::Ball { radius: 0.031 }, 0.022, 0.022, 0.0),
        Placed::new(Shape::Roll { radius: 0.018, half_length: 0.040 }, -0.030, -0.145, 12.0),
        Placed::new(Shape::Carton { half: [0.036, 0.023, 0.017] }, 0.125, 0.012, -20.0),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_object_is_inside_another() {
        let objects = clutter();
        for (i, a) in objects.iter().enumerate() {
            for b in &objects[i + 1..] {
                let n = 60;
                for index in 0..n * n * n {
                    let at = |k: usize| k as f64 * 0.4 / n as f64;
                    let p =
                        Point3::new(at(index % n) - 0.2, at(index / n % n) - 0.2, at(index / n / n) * 0.5);
                    assert!(a.distance(&p).max(b.distance(&p)) > -0.001, "{a:?} and {b:?} at {p}");
                }
            }
        }
    }
}
