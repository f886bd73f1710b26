//! Collision and visual shapes of a URDF.

use nalgebra::{Translation3, Vector3};

use crate::error::Findings;
use crate::files::URDF;
use crate::urdf::{MAX_LENGTH_M, pose};
use crate::{CollisionShape, HandFiles, Shape, Tree, mesh_files};

/// Most shapes of one link.
const MAX_SHAPES: usize = 64;
/// Most triangles of all meshes together.
const MAX_TRIANGLES: usize = 400_000;

/// Collision and visual shapes of all links, in the order of the tree's links.
pub(crate) fn read(
    robot: &urdf_rs::Robot,
    tree: &Tree,
    files: &HandFiles,
    findings: &mut Findings,
) -> (Vec<CollisionShape>, Vec<CollisionShape>) {
    let mut budget = MAX_TRIANGLES;
    let (mut collision, mut visuals) = (Vec::new(), Vec::new());
    for (index, link) in tree.links.iter().enumerate() {
        let Some(source) = robot.links.iter().find(|l| l.name == link.name) else { continue };
        if source.collision.len() > MAX_SHAPES || source.visual.len() > MAX_SHAPES {
            findings.error(
                URDF,
                format!("link {:?}", link.name),
                format!("{} collision and {} visual elements", source.collision.len(), source.visual.len()),
                format!("at most {MAX_SHAPES} of each"),
            );
            continue;
        }
        let mut own_visuals = Vec::new();
        for (i, visual) in source.visual.iter().enumerate() {
            let field = format!("link {:?} visual {i}", link.name);
            // A drawing that cannot be loaded is no reason to refuse a hand, except where it reaches outside.
            let mut aside = Findings::default();
            own_visuals.extend(shape(
                index,
                &visual.origin,
                &visual.geometry,
                &field,
                files,
                &mut budget,
                &mut aside,
            ));
            let fatal = matches!(&visual.geometry, urdf_rs::Geometry::Mesh { filename, .. } if mesh_files::path(filename).is_err());
            for problem in aside.errors {
                if fatal { findings.errors.push(problem) } else { findings.warnings.push(problem) }
            }
            findings.warnings.extend(aside.warnings);
        }
        let mut own = Vec::new();
        for (i, item) in source.collision.iter().enumerate() {
            let field = format!("link {:?} collision {i}", link.name);
            own.extend(shape(index, &item.origin, &item.geometry, &field, files, &mut budget, findings));
        }
        if source.collision.is_empty() && !own_visuals.is_empty() {
            findings.warn(
                URDF,
                format!("link {:?} collision", link.name),
                "none",
                "a collision element (the visual shapes are used)",
            );
            own.clone_from(&own_visuals);
        }
        visuals.extend(if own_visuals.is_empty() { own.clone() } else { own_visuals });
        collision.extend(own);
    }
    (collision, visuals)
}

/// The shapes of one geometry element: one, or three for a capsule, or none after an error.
fn shape(
    link: usize,
    origin: &urdf_rs::Pose,
    geometry: &urdf_rs::Geometry,
    field: &str,
    files: &HandFiles,
    budget: &mut usize,
    findings: &mut Findings,
) -> Vec<CollisionShape> {
    use urdf_rs::Geometry;
    let before = findings.errors.len();
    let link_from_shape = pose(origin, &format!("{field} origin"), findings);
    let mut size = |what: &str, value: f64| {
        if !(value > 0.0 && value <= MAX_LENGTH_M) {
            findings.error(URDF, format!("{field} {what}"), value, "more than 0 and at most 2 metres");
        }
        value
    };
    let at = |z: f64, shape: Shape| CollisionShape {
        link,
        link_from_shape: link_from_shape * Translation3::new(0.0, 0.0, z),
        shape,
    };
    let shapes = match geometry {
        Geometry::Box { size: edges } => {
            let half_extents = Vector3::from(edges.0.map(|e| size("box size", e))) / 2.0;
            vec![at(0.0, Shape::Box { half_extents })]
        }
        Geometry::Cylinder { radius, length } => {
            let (radius, half_length) = (size("radius", *radius), size("length", *length) / 2.0);
            vec![at(0.0, Shape::Cylinder { radius, half_length })]
        }
        Geometry::Capsule { radius, length } => {
            let (radius, half_length) = (size("radius", *radius), size("length", *length) / 2.0);
            vec![
                at(0.0, Shape::Cylinder { radius, half_length }),
                at(half_length, Shape::Sphere { radius }),
                at(-half_length, Shape::Sphere { radius }),
            ]
        }
        Geometry::Sphere { radius } => vec![at(0.0, Shape::Sphere { radius: size("radius", *radius) })],
        Geometry::Mesh { filename, scale } => {
            let scale = scale.map_or([1.0; 3], |s| s.0);
            match mesh_files::load(files, filename, scale, budget) {
                Ok(shape) => vec![at(0.0, shape)],
                Err((file, found, expected)) => {
                    findings.error(
                        &file.unwrap_or_else(|| URDF.to_owned()),
                        format!("{field} mesh"),
                        found,
                        expected,
                    );
                    Vec::new()
                }
            }
        }
    };
    if findings.errors.len() > before { Vec::new() } else { shapes }
}
