//! What a perfect depth camera would see: triangles rasterized into a z-buffer.

mod collect;
mod palette;
mod picture;
mod raster;
pub mod solids;

pub use picture::{RgbImage, depth_picture, picture};

use nalgebra::Isometry3;

use collect::Sight;
use raster::Piece;

use crate::camera::Pinhole;
use crate::mesh::Mesh;
use crate::object::Surface;
use crate::world::World;

/// A mesh somewhere in the world.
#[derive(Debug, Clone, Copy)]
pub struct Instance<'a> {
    /// Its shape.
    pub mesh: &'a Mesh,
    /// Its pose.
    pub world_from_mesh: Isometry3<f64>,
    /// Its value in the instance mask.
    pub id: u16,
    /// What a depth camera gets back from it.
    pub surface: Surface,
}

/// Value of table and tray, and of nothing at all, in an instance mask.
pub const BACKGROUND: u16 = 0;
/// Value of the first hand in an instance mask; objects have the numbers of their ids, below it.
pub const FIRST_HAND: u16 = 60_000;

/// A perfect view, row major, `width * height` values each.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// The lens.
    pub lens: Pinhole,
    /// Pose of the optical frame, world frame.
    pub world_from_camera: Isometry3<f64>,
    /// Distance along the optical axis, metres; NaN where there is nothing.
    pub depth_m: Vec<f32>,
    /// Instance of each pixel.
    pub instance: Vec<u16>,
    /// Cosine of the angle between the ray and the surface's normal, 0 to 1.
    pub cos_incidence: Vec<f32>,
    /// Diffuse reflectivity.
    pub albedo: Vec<f32>,
    /// Mirrored share.
    pub specular: Vec<f32>,
}

/// Rasterizes instances: the nearest surface at each pixel's centre, whichever side of it is seen. Triangles that
/// are not finite, or refer to vertices that do not exist, are left out; so is what is nearer than a millimetre.
pub fn render(lens: &Pinhole, world_from_camera: &Isometry3<f64>, instances: &[Instance<'_>]) -> View {
    let pieces: Vec<_> = instances
        .iter()
        .map(|i| Piece {
            vertices: &i.mesh.vertices,
            triangles: &i.mesh.triangles,
            world_from_piece: i.world_from_mesh,
            id: i.id,
            surface: i.surface,
        })
        .collect();
    view(lens, world_from_camera, &pieces)
}

/// What a camera sees of a world: table, tray, objects, hands. Objects have the numbers of their ids in the
/// mask, hands [`FIRST_HAND`] plus their place in [`World::hand_ids`].
pub fn capture(world: &World, lens: &Pinhole, world_from_camera: &Isometry3<f64>) -> View {
    view(lens, world_from_camera, &Sight::of(world).pieces())
}

fn view(lens: &Pinhole, world_from_camera: &Isometry3<f64>, pieces: &[Piece<'_>]) -> View {
    let raster = raster::rasterize(lens, world_from_camera, pieces);
    let pixels = raster.facet.len();
    let (mut instance, mut cos_incidence) = (vec![BACKGROUND; pixels], vec![0.0; pixels]);
    let (mut albedo, mut specular) = (vec![0.0; pixels], vec![0.0; pixels]);
    let seen: Vec<_> =
        pieces.iter().map(|p| (p.id, p.surface.albedo as f32, p.surface.specular as f32)).collect();
    for (i, &facet) in raster.facet.iter().enumerate() {
        let Some(facet) = raster.facets.get(facet as usize) else { continue };
        (instance[i], albedo[i], specular[i]) = seen[facet.piece as usize];
        cos_incidence[i] = facet.distance;
    }
    let x: Vec<f32> = (0..lens.width).map(|u| ((u as f64 - lens.cx_px) / lens.fx_px) as f32).collect();
    // Images without columns have no rows either: a chunk must have a size.
    let width = lens.width.max(1);
    for (v, (cos, inverse)) in
        cos_incidence.chunks_exact_mut(width).zip(raster.inverse.chunks_exact(width)).enumerate()
    {
        let y = ((v as f64 - lens.cy_px) / lens.fy_px) as f32;
        for ((cos, inverse), x) in cos.iter_mut().zip(inverse).zip(&x) {
            // The plane's distance over that of the point: the ray's length at depth 1 times the depth.
            *cos = (*cos * inverse / (1.0 + x * x + y * y).sqrt()).min(1.0);
        }
    }
    let mut depth_m = raster.inverse;
    for depth in &mut depth_m {
        *depth = if *depth > 0.0 { 1.0 / *depth } else { f32::NAN };
    }
    View {
        lens: *lens,
        world_from_camera: *world_from_camera,
        depth_m,
        instance,
        cos_incidence,
        albedo,
        specular,
    }
}

#[cfg(test)]
mod tests;
