//! The rasterizer: triangles become spans of pixels, the nearest one wins.
//!
//! Along a plane the *inverse* depth is linear in the pixel's coordinates, so each triangle is reduced to the
//! plane it lies in and three projected corners. The plane is set up in double precision from the unclipped
//! triangle: a table of a metre across has the same depth error as a face of a millimetre.

use nalgebra::{Isometry3, Point3, Vector3};

use crate::camera::Pinhole;
use crate::object::Surface;

/// What is nearer than this to the camera, along its axis, is cut away, metres.
pub(crate) const NEAR_M: f64 = 1e-3;
/// In [`Raster::facet`]: nothing is seen there.
pub(crate) const NOTHING: u32 = u32::MAX;

/// Triangles somewhere in the world.
#[derive(Debug, Clone)]
pub(crate) struct Piece<'a> {
    pub(crate) vertices: &'a [Point3<f64>],
    pub(crate) triangles: &'a [[u32; 3]],
    pub(crate) world_from_piece: Isometry3<f64>,
    pub(crate) id: u16,
    pub(crate) surface: Surface,
}

/// A triangle that may be seen: what is the same for all of its pixels.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Facet {
    /// Unit normal towards the camera, camera frame.
    pub(crate) normal: Vector3<f32>,
    /// Distance of its plane from the camera's centre, metres.
    pub(crate) distance: f32,
    /// Index of its piece.
    pub(crate) piece: u32,
}

/// A visibility buffer, row major.
#[derive(Debug, Clone, Default)]
pub(crate) struct Raster {
    /// Inverse depth, 1/metres; 0 where there is nothing.
    pub(crate) inverse: Vec<f32>,
    /// Index of the facet seen, or [`NOTHING`].
    pub(crate) facet: Vec<u32>,
    /// The facets.
    pub(crate) facets: Vec<Facet>,
    /// Corners of the piece at hand: kept only for its memory.
    corners: Vec<Corner>,
}

/// A corner in the camera frame and where it projects to; the projection is NaN behind the near plane.
#[derive(Debug, Clone, Copy)]
struct Corner {
    p: Vector3<f64>,
    u: f64,
    v: f64,
}

impl Corner {
    fn new(p: Vector3<f64>, lens: &Pinhole) -> Self {
        let inverse = if p.z >= NEAR_M { 1.0 / p.z } else { f64::NAN };
        Self { p, u: lens.fx_px * p.x * inverse + lens.cx_px, v: lens.fy_px * p.y * inverse + lens.cy_px }
    }
}

/// Inverse depth as a function of the pixel, and the bounds it must keep to.
struct Plane {
    at_origin: f64,
    per_u: f64,
    per_v: f64,
    low: f32,
    high: f32,
}

/// Rasterizes pieces: [`Raster::draw`] into memory of its own.
pub(crate) fn rasterize(lens: &Pinhole, world_from_camera: &Isometry3<f64>, pieces: &[Piece<'_>]) -> Raster {
    let mut raster = Raster::default();
    raster.draw(lens, world_from_camera, pieces);
    raster
}

impl Raster {
    /// Rasterizes pieces into the memory of what was rasterized before; both sides of each triangle are drawn.
    /// Triangles with corners that are not finite, or with indices out of range, are left out.
    pub(crate) fn draw(&mut self, lens: &Pinhole, world_from_camera: &Isometry3<f64>, pieces: &[Piece<'_>]) {
        let pixels = lens.width.saturating_mul(lens.height);
        self.facets.clear();
        refill(&mut self.inverse, pixels, 0.0);
        refill(&mut self.facet, pixels, NOTHING);
        if pixels == 0 {
            return;
        }
        let camera_from_world = world_from_camera.inverse();
        let mut corners = std::mem::take(&mut self.corners);
        for (index, piece) in pieces.iter().enumerate() {
            let camera_from_piece = camera_from_world * piece.world_from_piece;
            let rotation = camera_from_piece.rotation.to_rotation_matrix();
            let translation = camera_from_piece.translation.vector;
            corners.clear();
            corners
                .extend(piece.vertices.iter().map(|v| Corner::new(rotation * v.coords + translation, lens)));
            for triangle in piece.triangles {
                let [Some(&a), Some(&b), Some(&c)] = triangle.map(|i| corners.get(i as usize)) else {
                    continue;
                };
                self.triangle(lens, index as u32, [a, b, c]);
            }
        }
        self.corners = corners;
    }

    fn triangle(&mut self, lens: &Pinhole, piece: u32, corners: [Corner; 3]) {
        let [a, b, c] = corners;
        let in_front = corners.iter().filter(|c| c.p.z >= NEAR_M).count();
        if in_front == 0 || (in_front == 3 && !covers_a_pixel(lens, &corners)) {
            return;
        }
        let normal = (b.p - a.p).cross(&(c.p - a.p));
        let distance = normal.dot(&a.p);
        let length = normal.norm();
        let scale = 1.0 / distance;
        let (per_u, per_v) = (normal.x * scale / lens.fx_px, normal.y * scale / lens.fy_px);
        let at_origin = normal.z * scale - per_u * lens.cx_px - per_v * lens.cy_px;
        // Degenerate, seen exactly edge on, or not finite: nothing to see.
        if !(per_u.is_finite() && per_v.is_finite() && at_origin.is_finite() && length > 0.0) {
            return;
        }
        let plane = |corners: &[Corner]| {
            let (near, far) = corners
                .iter()
                .fold((f64::INFINITY, NEAR_M), |(near, far), c| (near.min(c.p.z), far.max(c.p.z)));
            // Keeps slivers seen edge on from reaching far beyond their corners.
            Plane { at_origin, per_u, per_v, low: (1.0 / far) as f32, high: (1.0 / near) as f32 }
        };
        let id = self.facets.len() as u32;
        self.facets.push(Facet {
            normal: (normal * (-distance.signum() / length)).cast(),
            distance: (distance.abs() / length) as f32,
            piece,
        });
        if in_front == 3 {
            self.fill(lens, corners, &plane(&corners), id);
        } else {
            let mut polygon = [a; 4];
            let count = clip(lens, &corners, &mut polygon);
            let polygon = &polygon[..count];
            for i in 2..count {
                self.fill(lens, [polygon[0], polygon[i - 1], polygon[i]], &plane(polygon), id);
            }
        }
    }

    /// Fills the pixels whose centres are inside. Edges are always walked from their upper end, so neighbours
    /// compute the same crossings: no pixel between them is left out or drawn twice.
    fn fill(&mut self, lens: &Pinhole, mut corners: [Corner; 3], plane: &Plane, id: u32) {
        let before = |a: &Corner, b: &Corner| (a.v, a.u) < (b.v, b.u);
        if before(&corners[1], &corners[0]) {
            corners.swap(0, 1);
        }
        if before(&corners[2], &corners[1]) {
            corners.swap(1, 2);
            if before(&corners[1], &corners[0]) {
                corners.swap(0, 1);
            }
        }
        let [top, middle, bottom] = corners;
        let long = slope(&top, &bottom);
        let bend = ceil_within(middle.v, lens.height);
        let halves = [
            (ceil_within(top.v, lens.height)..bend, top, slope(&top, &middle)),
            (bend..ceil_within(bottom.v, lens.height), middle, slope(&middle, &bottom)),
        ];
        for (rows, from, short) in halves {
            for row in rows {
                let v = row as f64;
                let (x, y) = (top.u + (v - top.v) * long, from.u + (v - from.v) * short);
                let (start, end) = (ceil_within(x.min(y), lens.width), ceil_within(x.max(y), lens.width));
                if start < end {
                    let first = plane.at_origin + plane.per_v * v + plane.per_u * start as f64;
                    self.span(row * lens.width + start, end - start, first as f32, plane, id);
                }
            }
        }
    }

    fn span(&mut self, start: usize, length: usize, first: f32, plane: &Plane, id: u32) {
        let (Some(inverse), Some(facet)) =
            (self.inverse.get_mut(start..start + length), self.facet.get_mut(start..start + length))
        else {
            return;
        };
        let step = plane.per_u as f32;
        for (i, (inverse, facet)) in inverse.iter_mut().zip(facet).enumerate() {
            let here = (first + step * i as i32 as f32).max(plane.low).min(plane.high);
            let nearer = here > *inverse;
            *inverse = if nearer { here } else { *inverse };
            *facet = if nearer { id } else { *facet };
        }
    }
}

/// Sets a list to one value, in the memory that it has: fresh memory costs more than drawing into it.
pub(crate) fn refill<T: Copy>(list: &mut Vec<T>, length: usize, value: T) {
    list.clear();
    list.resize(length, value);
}

fn slope(from: &Corner, to: &Corner) -> f64 {
    (to.u - from.u) / (to.v - from.v)
}

/// The first pixel centre at or after a coordinate, within `0..=size`.
fn ceil_within(x: f64, size: usize) -> usize {
    let x = x.max(0.0).min(size as f64);
    let whole = x as i32;
    (whole + i32::from(f64::from(whole) < x)) as usize
}

/// Whether the bounding box of a projected triangle holds a pixel centre of the image.
fn covers_a_pixel(lens: &Pinhole, [a, b, c]: &[Corner; 3]) -> bool {
    let spans = |x: f64, y: f64, z: f64, size: usize| {
        ceil_within(x.min(y).min(z), size) < ceil_within(x.max(y).max(z), size)
    };
    spans(a.v, b.v, c.v, lens.height) && spans(a.u, b.u, c.u, lens.width)
}

/// Cuts a triangle at the near plane; the number of corners of what remains.
fn clip(lens: &Pinhole, corners: &[Corner; 3], polygon: &mut [Corner; 4]) -> usize {
    let mut count = 0;
    let mut keep = |corner| {
        if let Some(slot) = polygon.get_mut(count) {
            *slot = corner;
            count += 1;
        }
    };
    for i in 0..3 {
        let (from, to) = (&corners[i], &corners[(i + 1) % 3]);
        if from.p.z >= NEAR_M {
            keep(*from);
        }
        if (from.p.z >= NEAR_M) != (to.p.z >= NEAR_M) {
            // Always from the visible end, so that both triangles at an edge cut it at the same point.
            let (inside, outside) = if from.p.z >= NEAR_M { (from, to) } else { (to, from) };
            let share = (inside.p.z - NEAR_M) / (inside.p.z - outside.p.z);
            let mut cut = inside.p + (outside.p - inside.p) * share;
            cut.z = NEAR_M;
            keep(Corner::new(cut, lens));
        }
    }
    count
}
