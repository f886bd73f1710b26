//! What a perfect depth camera would see: triangles rasterized into a z-buffer.

mod collect;
mod raster;
pub mod solids;

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

impl View {
    /// A view of nothing at all.
    fn empty(lens: &Pinhole, world_from_camera: &Isometry3<f64>) -> Self {
        let pixels = lens.width.saturating_mul(lens.height);
        Self {
            lens: *lens,
            world_from_camera: *world_from_camera,
            depth_m: vec![f32::NAN; pixels],
            instance: vec![BACKGROUND; pixels],
            cos_incidence: vec![0.0; pixels],
            albedo: vec![0.0; pixels],
            specular: vec![0.0; pixels],
        }
    }
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
    let mut view = View::empty(lens, world_from_camera);
    if view.depth_m.is_empty() {
        return view;
    }
    let seen: Vec<_> =
        pieces.iter().map(|p| (p.id, p.surface.albedo as f32, p.surface.specular as f32)).collect();
    let x: Vec<f32> = (0..lens.width).map(|u| ((u as f64 - lens.cx_px) / lens.fx_px) as f32).collect();
    for v in 0..lens.height {
        let y = ((v as f64 - lens.cy_px) / lens.fy_px) as f32;
        let row = v * lens.width..(v + 1) * lens.width;
        for (x, i) in x.iter().zip(row) {
            let Some(facet) = raster.facets.get(raster.facet[i] as usize) else { continue };
            let inverse = raster.inverse[i];
            let (id, albedo, specular) = seen[facet.piece as usize];
            view.depth_m[i] = 1.0 / inverse;
            view.instance[i] = id;
            // The ray's length at depth 1 over the plane's distance at depth 1.
            view.cos_incidence[i] = (facet.distance * inverse / (1.0 + x * x + y * y).sqrt()).min(1.0);
            view.albedo[i] = albedo;
            view.specular[i] = specular;
        }
    }
    view
}
