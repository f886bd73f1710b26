//! The inner faces of the fingers' last parts.

use nalgebra::{Isometry3, Point3, Unit, Vector3};

use super::fingers::Chain;
use super::motion::Motion;
use crate::Shape;
use crate::solid::Solid;
use crate::urdf::Model;

/// Pads take this share of a face: its rim is rarely flat.
const SHARE: f64 = 0.8;
/// Largest half edge, metres.
const MAX_HALF_M: f64 = 0.03;
/// A face must be turned towards the closing motion by at least this cosine.
const FACING: f64 = 0.5;

/// A proposed pad, in its link's frame.
#[derive(Debug, Clone)]
pub(super) struct PadGuess {
    pub(super) finger: usize,
    pub(super) link: usize,
    pub(super) center: Point3<f64>,
    pub(super) half_u: Vector3<f64>,
    pub(super) half_v: Vector3<f64>,
    pub(super) normal: Unit<Vector3<f64>>,
    /// How squarely the face looks along the closing motion.
    pub(super) cosine: f64,
}

/// A face of a shape, in the shape's frame.
struct Face {
    center: Point3<f64>,
    half_u: Vector3<f64>,
    half_v: Vector3<f64>,
    normal: Vector3<f64>,
}

/// Finds a pad for each finger that has a face turned towards its closing motion.
pub(super) fn find(model: &Model, fingers: &[Chain], motion: &Motion, palm: &Point3<f64>) -> Vec<PadGuess> {
    let poses = |fraction: f64| model.tree.body_poses(&motion.joints(&model.mimics, fraction));
    let (now, next) = (poses(0.5), poses(0.51));
    let tips: Vec<Point3<f64>> = fingers.iter().map(|f| now[f.last()] * f.tip).collect();
    let middle = super::middle(&tips);
    let outwards = (middle - palm).try_normalize(1e-6).unwrap_or_else(Vector3::z);
    let mut out = Vec::new();
    for (index, finger) in fingers.iter().enumerate() {
        let body = finger.last();
        let solids = super::solids(model, body);
        let mut best: Option<(f64, PadGuess)> = None;
        let reach = solids.iter().map(|(_, _, s)| (now[body] * centre(s) - palm).dot(&outwards));
        let (low, high) = reach.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), r| (l.min(r), h.max(r)));
        for (link, shape, solid) in &solids {
            let body_from_link = model.tree.links[*link].body_from_link;
            let body_from_shape = body_from_link * shape.link_from_shape;
            // The direction in which this part closes, in the shape's frame.
            let middle_of_shape = now[body] * centre(solid);
            let velocity = next[body] * centre(solid) - middle_of_shape;
            let way = middle - middle_of_shape;
            let blend = velocity.try_normalize(1e-9).unwrap_or_default()
                + 0.5 * way.try_normalize(1e-6).unwrap_or_default();
            let Some(direction) = blend.try_normalize(1e-6) else { continue };
            let in_body = now[body].rotation.inverse() * direction;
            let in_shape = body_from_shape.rotation.inverse() * in_body;
            for face in faces(&shape.shape, solid, &body_from_shape, &in_shape) {
                let cosine = face.normal.dot(&in_shape);
                let at = body_from_shape * face.center;
                let normal = body_from_shape.rotation * face.normal;
                let free = at + normal * 0.003;
                if cosine < FACING || solids.iter().any(|(_, _, s)| s.depth(&free) > 0.0) {
                    continue;
                }
                let distal = ((now[body] * at - palm).dot(&outwards) - low) / (high - low).max(0.005);
                let area = 4.0 * face.half_u.norm() * face.half_v.norm();
                // Squarely facing, far out, and not a sliver.
                let score = cosine + 0.6 * distal.clamp(0.0, 1.0) + 0.3 * (area / 2e-4).min(1.0);
                if best.as_ref().is_none_or(|(s, _)| score > *s) {
                    let pose: Isometry3<f64> = shape.link_from_shape;
                    let edge =
                        |e: Vector3<f64>| pose.rotation * e * (SHARE).min(MAX_HALF_M / e.norm().max(1e-9));
                    let guess = PadGuess {
                        finger: index,
                        link: *link,
                        center: pose * face.center,
                        half_u: edge(face.half_u),
                        half_v: edge(face.half_v),
                        normal: Unit::new_normalize(pose.rotation * face.normal),
                        cosine,
                    };
                    best = Some((score, guess));
                }
            }
        }
        out.extend(best.map(|(_, guess)| guess));
    }
    out
}

/// Middle of a solid's bounds.
fn centre(solid: &Solid<'_>) -> Point3<f64> {
    let (low, high) = solid.bounds();
    nalgebra::center(&low, &high)
}

/// Faces of a shape that could carry a pad, in the shape's frame.
fn faces(
    shape: &Shape,
    solid: &Solid<'_>,
    query_from_shape: &Isometry3<f64>,
    towards: &Vector3<f64>,
) -> Vec<Face> {
    let (low, high) = solid.local_bounds();
    match shape {
        Shape::Box { .. } => box_faces(&low, &high),
        Shape::Mesh { .. } => box_faces(&low, &high)
            .into_iter()
            .filter_map(|face| onto_surface(face, solid, query_from_shape, (high - low).norm()))
            .collect(),
        Shape::Cylinder { radius, half_length } => {
            let mut faces = Vec::new();
            let side = Vector3::new(towards.x, towards.y, 0.0);
            if let Some(normal) = side.try_normalize(1e-3) {
                faces.push(Face {
                    center: Point3::from(normal * *radius),
                    half_u: Vector3::z() * *half_length,
                    half_v: Vector3::z().cross(&normal) * (0.4 * radius),
                    normal,
                });
            }
            for z in [-1.0, 1.0] {
                faces.push(Face {
                    center: Point3::new(0.0, 0.0, z * half_length),
                    half_u: Vector3::x() * (0.7 * radius),
                    half_v: Vector3::y() * (0.7 * radius),
                    normal: Vector3::z() * z,
                });
            }
            faces
        }
        Shape::Sphere { radius } => {
            let normal = *towards;
            let aside = if normal.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
            let half_u = normal.cross(&aside).normalize();
            vec![Face {
                center: Point3::from(normal * *radius),
                half_u: half_u * (0.4 * radius),
                half_v: normal.cross(&half_u) * (0.4 * radius),
                normal,
            }]
        }
    }
}

fn box_faces(low: &Point3<f64>, high: &Point3<f64>) -> Vec<Face> {
    let (center, half) = (nalgebra::center(low, high), (high - low) / 2.0);
    let mut out = Vec::with_capacity(6);
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let unit = |i: usize| Vector3::ith(i % 3, half[i % 3]);
            let normal = Vector3::ith(axis, side);
            out.push(Face {
                center: center + normal * half[axis],
                half_u: unit(axis + 1),
                half_v: unit(axis + 2),
                normal,
            });
        }
    }
    out
}

/// Moves a face of a mesh's box inwards until it meets the mesh; `None` when it never does.
fn onto_surface(face: Face, solid: &Solid<'_>, query_from_shape: &Isometry3<f64>, size: f64) -> Option<Face> {
    let mut travelled = 0.0;
    while travelled < size {
        let center = face.center - face.normal * travelled;
        let distance = -solid.depth(&(query_from_shape * center));
        if distance < 2e-4 {
            return Some(Face { center, half_u: face.half_u * 0.5, half_v: face.half_v * 0.5, ..face });
        }
        // The surface is at least this far away in every direction.
        travelled += distance;
    }
    None
}
