//! What a perfect depth camera would see: triangles rasterized into a z-buffer.

mod collect;
mod palette;
mod picture;
mod raster;
pub mod solids;

pub use picture::{RgbImage, depth_picture, picture};

use nalgebra::Isometry3;

use collect::Sight;
pub(crate) use raster::refill;
use raster::{NOTHING, Piece, Raster};

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
    let mut renderer = Renderer::new();
    renderer.render(lens, world_from_camera, instances);
    renderer.view
}

/// What a camera sees of a world: table, tray, objects, hands. Objects have the numbers of their ids in the
/// mask, hands [`FIRST_HAND`] plus their place in [`World::hand_ids`].
pub fn capture(world: &World, lens: &Pinhole, world_from_camera: &Isometry3<f64>) -> View {
    let mut renderer = Renderer::new();
    renderer.capture(world, lens, world_from_camera);
    renderer.view
}

/// Renders view after view in the same memory. Getting fresh memory for every view takes about as long as drawing
/// it: an image has several million bytes, and the system hands them out, zeroed, page by page.
#[derive(Debug, Clone)]
pub struct Renderer {
    raster: Raster,
    view: View,
    /// Slopes of the rays of each column.
    columns: Vec<f32>,
}

impl Default for Renderer {
    fn default() -> Self {
        Self::new()
    }
}

impl Renderer {
    /// A renderer that has seen nothing yet.
    pub fn new() -> Self {
        let lens = Pinhole { width: 0, height: 0, fx_px: 1.0, fy_px: 1.0, cx_px: 0.0, cy_px: 0.0 };
        let view = View {
            lens,
            world_from_camera: Isometry3::identity(),
            depth_m: Vec::new(),
            instance: Vec::new(),
            cos_incidence: Vec::new(),
            albedo: Vec::new(),
            specular: Vec::new(),
        };
        Self { raster: Raster::default(), view, columns: Vec::new() }
    }

    /// The view that was rendered last.
    pub fn view(&self) -> &View {
        &self.view
    }

    /// As the function [`render`], until the next view.
    pub fn render(
        &mut self,
        lens: &Pinhole,
        world_from_camera: &Isometry3<f64>,
        instances: &[Instance<'_>],
    ) -> &View {
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
        self.draw(lens, world_from_camera, &pieces)
    }

    /// As the function [`capture`], until the next view.
    pub fn capture(&mut self, world: &World, lens: &Pinhole, world_from_camera: &Isometry3<f64>) -> &View {
        self.draw(lens, world_from_camera, &Sight::of(world).pieces())
    }

    fn draw(&mut self, lens: &Pinhole, world_from_camera: &Isometry3<f64>, pieces: &[Piece<'_>]) -> &View {
        let (raster, view) = (&mut self.raster, &mut self.view);
        // The depth of a view is the raster's inverse depth, inverted in place.
        std::mem::swap(&mut raster.inverse, &mut view.depth_m);
        raster.draw(lens, world_from_camera, pieces);
        std::mem::swap(&mut raster.inverse, &mut view.depth_m);
        let pixels = raster.facet.len();
        // Every pixel is written below: what is left from the last view need not be cleared.
        view.instance.resize(pixels, BACKGROUND);
        for list in [&mut view.cos_incidence, &mut view.albedo, &mut view.specular] {
            list.resize(pixels, 0.0);
        }
        (view.lens, view.world_from_camera) = (*lens, *world_from_camera);
        self.columns.clear();
        self.columns.extend((0..lens.width).map(|u| ((u as f64 - lens.cx_px) / lens.fx_px) as f32));
        // Images without columns have no rows either.
        for row in 0..if pixels > 0 { lens.height } else { 0 } {
            self.fill_row(row, pieces);
        }
        &self.view
    }

    /// What a row's pixels show, from their facets and inverse depths.
    fn fill_row(&mut self, row: usize, pieces: &[Piece<'_>]) {
        let (raster, view) = (&self.raster, &mut self.view);
        let (lens, width) = (&view.lens, view.lens.width);
        let y = ((row as f64 - lens.cy_px) / lens.fy_px) as f32;
        let pixels = row * width..(row + 1) * width;
        let (instance, albedo) = (&mut view.instance[pixels.clone()], &mut view.albedo[pixels.clone()]);
        let (specular, cos) = (&mut view.specular[pixels.clone()], &mut view.cos_incidence[pixels.clone()]);
        let facet = &raster.facet[pixels.clone()];
        // Neighbours mostly show the same facet.
        let mut last = (NOTHING, BACKGROUND, 0.0, 0.0, 0.0);
        for i in 0..width {
            if facet[i] != last.0 {
                let shown = raster.facets.get(facet[i] as usize);
                let piece = shown.and_then(|f| pieces.get(f.piece as usize).map(|p| (f, p)));
                last = piece.map_or((facet[i], BACKGROUND, 0.0, 0.0, 0.0), |(f, p)| {
                    (facet[i], p.id, p.surface.albedo as f32, p.surface.specular as f32, f.distance)
                });
            }
            (instance[i], albedo[i], specular[i], cos[i]) = (last.1, last.2, last.3, last.4);
        }
        for ((cos, depth), x) in cos.iter_mut().zip(&mut view.depth_m[pixels]).zip(&self.columns) {
            let inverse = *depth;
            // The plane's distance over that of the point: the ray's length at depth 1 times the depth.
            *cos = (*cos * inverse / (1.0 + x * x + y * y).sqrt()).min(1.0);
            *depth = if inverse > 0.0 { 1.0 / inverse } else { f32::NAN };
        }
    }
}

#[cfg(test)]
mod tests;
