//! What a perfect depth camera would see: triangles rasterized into a z-buffer.

use nalgebra::Isometry3;

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

/// Rasterizes instances.
pub fn render(lens: &Pinhole, world_from_camera: &Isometry3<f64>, instances: &[Instance<'_>]) -> View {
    unimplemented!("{lens:?} {world_from_camera} {instances:?}")
}

/// What a camera sees of a world: table, tray, objects, hands.
pub fn capture(world: &World, lens: &Pinhole, world_from_camera: &Isometry3<f64>) -> View {
    unimplemented!("{world:?} {lens:?} {world_from_camera}")
}
