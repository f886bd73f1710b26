//! Contact pads: the regions of a finger's surface that may touch, and the candidates sampled on them.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};

/// A flat rectangular region of a link's surface that may touch an object.
#[derive(Debug, Clone, PartialEq)]
pub struct Pad {
    /// Name, unique in the hand.
    pub name: String,
    /// The link that carries the pad; index into [`crate::Tree::links`].
    pub link: usize,
    /// The finger that the link belongs to; index into [`crate::Hand::fingers`].
    pub finger: usize,
    /// Centre in the link frame, metres.
    pub center: Point3<f64>,
    /// Half edge vectors in the link frame, metres: the corners are `center ± half_u ± half_v`.
    pub half_u: Vector3<f64>,
    /// The other half edge vector.
    pub half_v: Vector3<f64>,
    /// Outward normal in the link frame: from the finger towards the object.
    pub normal: Unit<Vector3<f64>>,
}

impl Pad {
    /// The pad's frame in the link frame: origin at the centre, x along `half_u`, z along the normal.
    pub fn frame(&self) -> Isometry3<f64> {
        let z = self.normal.into_inner();
        // Edges that are only roughly across the normal are made so.
        let x = (self.half_u - z * z.dot(&self.half_u)).normalize();
        let axes = Matrix3::from_columns(&[x, z.cross(&x), z]);
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        Isometry3::from_parts(Translation3::from(self.center.coords), rotation)
    }

    /// The four corners in the link frame, in turn around the pad, metres.
    pub fn corners(&self) -> [Point3<f64>; 4] {
        let (c, u, v) = (self.center, self.half_u, self.half_v);
        [c - u - v, c + u - v, c + u + v, c - u + v]
    }
}

/// A sample of a pad: a point of the hand that may become a contact, with its outward normal.
///
/// The paper's `c_h` in `C_H`; 9 per pad for hands with up to three pads, else 5 (the counts of
/// Supplementary Table 2).
#[derive(Debug, Clone, PartialEq)]
pub struct ContactCandidate {
    /// Index into [`crate::Hand::pads`].
    pub pad: usize,
    /// The body that carries it; index into [`crate::Tree::bodies`].
    pub body: usize,
    /// Point in the *body* frame, metres.
    pub point: Point3<f64>,
    /// Outward normal in the *body* frame.
    pub normal: Unit<Vector3<f64>>,
}
