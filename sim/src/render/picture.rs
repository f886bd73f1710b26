//! Pictures for people: a shaded view of a world, and depth images in false colour.
//!
//! Samples are shaded from the visibility buffer at twice the resolution: a sun with a shadow map, light from the sky
//! darkened where surroundings hide it, faint lines every 10 cm on the table, outlines between things.

use nalgebra::{Isometry3, Point3, Vector3};
use rayon::prelude::*;

use super::collect::{Kind, Sight};
use super::palette;
use super::raster::{self, Raster};
use crate::camera::{Pinhole, look_at};
use crate::sensor::DepthImage;
use crate::world::World;

/// A colour picture.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RgbImage {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Red, green and blue (sRGB), row major.
    pub pixels: Vec<[u8; 3]>,
}

/// Linear light: red, green, blue.
type Light = Vector3<f32>;

/// Samples along each side of a pixel.
const SAMPLES: usize = 2;
/// Side of the shadow map, pixels.
const SHADOW_PX: usize = 1536;
/// How far the sun stands from what is looked at, metres: far enough for nearly parallel shadows.
const SUN_M: f64 = 6.0;
/// Half of what the shadow map covers there, metres.
const SHADOW_HALF_M: f64 = 0.75;
/// Towards the sun, world frame.
const SUN: [f64; 3] = [-0.45, -0.5, 1.0];
/// How far hidden sky is looked for, metres.
const OCCLUSION_M: f32 = 0.06;

/// A shaded picture of a world: each object in a colour of its own, hands grey-blue.
pub fn picture(world: &World, lens: &Pinhole, world_from_camera: &Isometry3<f64>) -> RgbImage {
    let (width, height) = (lens.width, lens.height);
    if width.saturating_mul(height) == 0 {
        return RgbImage { width, height, pixels: Vec::new() };
    }
    let sight = Sight::of(world);
    let scene = Scene::new(&sight, lens, world_from_camera);
    let samples = scene.lens.width;
    let lit: Vec<Light> = (0..scene.raster.facet.len()).into_par_iter().map(|i| scene.shade(i)).collect();
    let pixels = (0..width * height)
        .map(|i| {
            let (row, column) = (i / width * SAMPLES, i % width * SAMPLES);
            let mut sum = Light::zeros();
            for v in row..row + SAMPLES {
                for u in column..column + SAMPLES {
                    sum += lit[v * samples + u];
                }
            }
            palette::encode(&(sum / (SAMPLES * SAMPLES) as f32))
        })
        .collect();
    RgbImage { width, height, pixels }
}

/// A depth image in false colour: yellow at the near end of `range_m`, violet at the far end, black where nothing
/// was returned.
pub fn depth_picture(image: &DepthImage, range_m: [f64; 2]) -> RgbImage {
    let [near, far] = range_m.map(|r| r as f32);
    let pixels = image
        .depth_m
        .iter()
        .map(|&z| if z > 0.0 { palette::false_colour((far - z) / (far - near)) } else { [0; 3] })
        .collect();
    RgbImage { width: image.width, height: image.height, pixels }
}

/// What is needed to shade a sample.
struct Scene<'a> {
    sight: &'a Sight<'a>,
    lens: Pinhole,
    /// Slopes of the rays of each column and row.
    columns: Vec<f32>,
    rows: Vec<f32>,
    world_from_camera: Isometry3<f64>,
    raster: Raster,
    sun: Vector3<f32>,
    sun_lens: Pinhole,
    sun_from_camera: Isometry3<f32>,
    shadow: Vec<f32>,
}

impl<'a> Scene<'a> {
    fn new(sight: &'a Sight<'a>, lens: &Pinhole, world_from_camera: &Isometry3<f64>) -> Self {
        let pieces = sight.pieces();
        let lens = finer(lens);
        let raster = raster::rasterize(&lens, world_from_camera, &pieces);
        let towards = Vector3::from(SUN).normalize();
        let center = looked_at(world_from_camera);
        let world_from_sun = look_at(&(center + towards * SUN_M), &center, &Vector3::y());
        let middle = (SHADOW_PX as f64 - 1.0) / 2.0;
        let focal = SHADOW_PX as f64 / 2.0 * SUN_M / SHADOW_HALF_M;
        let sun_lens = Pinhole {
            width: SHADOW_PX,
            height: SHADOW_PX,
            fx_px: focal,
            fy_px: focal,
            cx_px: middle,
            cy_px: middle,
        };
        let shadow = raster::rasterize(&sun_lens, &world_from_sun, &pieces).inverse;
        Self {
            sight,
            lens,
            columns: (0..lens.width).map(|u| lens.ray(u as f64, 0.0).x as f32).collect(),
            rows: (0..lens.height).map(|v| lens.ray(0.0, v as f64).y as f32).collect(),
            world_from_camera: *world_from_camera,
            raster,
            sun: (world_from_camera.rotation.inverse() * towards).cast(),
            sun_lens,
            sun_from_camera: (world_from_sun.inverse() * world_from_camera).cast(),
            shadow,
        }
    }

    fn ray(&self, i: usize) -> Vector3<f32> {
        let (u, v) = (i % self.lens.width, i / self.lens.width);
        Vector3::new(self.columns[u], self.rows[v], 1.0)
    }

    fn kind(&self, i: usize) -> Option<Kind> {
        let facet = self.raster.facets.get(self.raster.facet[i] as usize)?;
        self.sight.kind(facet.piece)
    }

    /// Light from one sample.
    fn shade(&self, i: usize) -> Light {
        let ray = self.ray(i);
        let up: Vector3<f32> = (self.world_from_camera.rotation.inverse() * Vector3::z()).cast();
        let (Some(facet), Some(kind)) = (self.raster.facets.get(self.raster.facet[i] as usize), self.kind(i))
        else {
            return palette::sky(ray.normalize().dot(&up));
        };
        let point = ray / self.raster.inverse[i];
        let normal = self.smooth_normal(i, &facet.normal);
        let colour = self.colour(kind, &point);
        let facing = normal.dot(&self.sun).max(0.0);
        let sun = if facing > 0.0 { facing * self.sunlight(&point, &facet.normal) } else { 0.0 };
        // Brighter from above than from below, as in a room.
        let sky = (0.62 + 0.38 * normal.dot(&up)) * self.open_sky(i, &point, &normal);
        let half = (self.sun - ray.normalize()).normalize();
        let polish = self.sight.surface(facet.piece).map_or(0.0, |s| s.specular as f32);
        let gloss = (0.06 + 0.5 * polish) * normal.dot(&half).max(0.0).powi(40) * sun.min(1.0);
        let warm = Light::new(1.0, 0.96, 0.88);
        let cool = Light::new(0.86, 0.93, 1.0);
        let light = warm * (0.72 * sun) + cool * (0.42 * sky);
        (colour.component_mul(&light) + warm * gloss) * self.outline(i, kind)
    }

    /// Colour of a surface in white light.
    fn colour(&self, kind: Kind, camera_point: &Vector3<f32>) -> Light {
        match kind {
            Kind::Object(number) => palette::object(number),
            Kind::Hand => palette::HAND,
            Kind::Tray => palette::TRAY,
            Kind::Table => {
                let p = self.world_from_camera * Point3::from(camera_point.cast::<f64>());
                // Lines keep about their width in pixels when they are far away.
                let width = (0.0012 * f64::from(camera_point.z)).max(0.0008);
                let line = |x: f64| (x - (x * 10.0).round() / 10.0).abs() < width;
                if p.z > -1e-4 && (line(p.x) || line(p.y)) { palette::TABLE * 0.82 } else { palette::TABLE }
            }
        }
    }

    /// The mean of the normals around a sample that nearly agree with its own: round things look round.
    fn smooth_normal(&self, i: usize, own: &Vector3<f32>) -> Vector3<f32> {
        let (u, v) = (i % self.lens.width, i / self.lens.width);
        let facet = self.raster.facet[i];
        let flat = |du, dv| self.neighbour(u, v, du, dv).is_none_or(|j| self.raster.facet[j] == facet);
        if flat(-5, -5) && flat(-5, 5) && flat(5, -5) && flat(5, 5) {
            return *own;
        }
        let Some(piece) = self.raster.facets.get(facet as usize).map(|f| f.piece) else { return *own };
        let mut sum = *own;
        for dv in -2..=2isize {
            for du in -2..=2isize {
                let Some(j) = self.neighbour(u, v, 3 * du, 3 * dv) else { continue };
                let Some(other) = self.raster.facets.get(self.raster.facet[j] as usize) else { continue };
                if other.piece == piece && other.normal.dot(own) > 0.85 {
                    sum += other.normal;
                }
            }
        }
        sum.try_normalize(1e-6).unwrap_or(*own)
    }

    /// Share of the sun that reaches a point, soft over a few pixels of the shadow map.
    fn sunlight(&self, point: &Vector3<f32>, normal: &Vector3<f32>) -> f32 {
        // Off the surface, or it would shade itself.
        let p = self.sun_from_camera * Point3::from(point + normal * 0.0025);
        let Some(([u, v], z)) = self.sun_lens.project(&p.cast()) else { return 1.0 };
        let [column, row] = [u, v].map(|x| x.round().clamp(-100.0, 2.0 * SHADOW_PX as f64) as isize);
        let (mut seen, mut reached) = (0u16, 0u16);
        for dv in -3..=3isize {
            for du in -3..=3isize {
                let (x, y) = (column + du, row + dv);
                let inside = (0..SHADOW_PX as isize).contains(&x) && (0..SHADOW_PX as isize).contains(&y);
                let lit =
                    !inside || 1.0 / self.shadow[y as usize * SHADOW_PX + x as usize] + 0.001 > z as f32;
                seen += 1;
                reached += u16::from(lit);
            }
        }
        f32::from(reached) / f32::from(seen)
    }

    /// Share of the sky that is not hidden by what is near, from samples around this one in the image.
    fn open_sky(&self, i: usize, point: &Vector3<f32>, normal: &Vector3<f32>) -> f32 {
        let (u, v) = (i % self.lens.width, i / self.lens.width);
        let reach = OCCLUSION_M * self.raster.inverse[i] * self.lens.fx_px as f32;
        let (mut hidden, mut count) = (0.0, 0.0);
        // Turned from ring to ring, and from sample to sample in a 4 x 4 pattern, so that no rays show.
        let turn = ((u % 4) * 4 + v % 4) as f32 * 0.065;
        for ring in 1..=3u8 {
            let (sin, cos) = (turn + f32::from(ring) * 0.4).sin_cos();
            let radius = reach * f32::from(ring) / 3.0;
            let mut arm = [radius * cos, radius * sin];
            for _ in 0..6 {
                // Six spokes, each a sixth of a turn on.
                arm = [0.5 * arm[0] - 0.866 * arm[1], 0.866 * arm[0] + 0.5 * arm[1]];
                count += 1.0;
                let Some(j) = self.neighbour(u, v, arm[0] as isize, arm[1] as isize) else {
                    continue;
                };
                if j == i || self.raster.inverse[j] == 0.0 {
                    continue;
                }
                let towards = self.ray(j) / self.raster.inverse[j] - point;
                let distance = towards.norm();
                let height = normal.dot(&towards) / distance.max(1e-6);
                let near = (1.0 - distance / (1.5 * OCCLUSION_M)).max(0.0);
                hidden += (height - 0.08).max(0.0) * near;
            }
        }
        (1.0 - 2.2 * hidden / count).clamp(0.15, 1.0)
    }

    /// Darkens the sample behind an outline: where something else begins, or depth jumps.
    fn outline(&self, i: usize, kind: Kind) -> f32 {
        let (u, v) = (i % self.lens.width, i / self.lens.width);
        let here = 1.0 / self.raster.inverse[i];
        for (du, dv) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
            let Some(j) = self.neighbour(u, v, du, dv) else { continue };
            let there = 1.0 / self.raster.inverse[j];
            let other = self.kind(j).is_some_and(|k| k != kind);
            if (other && there < here + 0.004) || there + 0.02 < here {
                return 0.55;
            }
        }
        1.0
    }

    fn neighbour(&self, u: usize, v: usize, du: isize, dv: isize) -> Option<usize> {
        let (u, v) = (u.checked_add_signed(du)?, v.checked_add_signed(dv)?);
        (u < self.lens.width && v < self.lens.height).then(|| v * self.lens.width + u)
    }
}

/// The same lens with more pixels.
fn finer(lens: &Pinhole) -> Pinhole {
    let times = SAMPLES as f64;
    // The corner of the image stays where it is, half a pixel before the first centre.
    let center = |c: f64| (c + 0.5) * times - 0.5;
    Pinhole {
        width: lens.width * SAMPLES,
        height: lens.height * SAMPLES,
        fx_px: lens.fx_px * times,
        fy_px: lens.fy_px * times,
        cx_px: center(lens.cx_px),
        cy_px: center(lens.cy_px),
    }
}

/// Where the optical axis meets the table, not too far from the camera; below the camera when it looks elsewhere.
fn looked_at(world_from_camera: &Isometry3<f64>) -> Point3<f64> {
    let eye = Point3::from(world_from_camera.translation.vector);
    let axis = world_from_camera.rotation * Vector3::z();
    let reach = if axis.z < -1e-3 { (-eye.z / axis.z).clamp(0.0, 2.0) } else { 0.0 };
    let p = eye + axis * reach;
    Point3::new(p.x, p.y, 0.0)
}
