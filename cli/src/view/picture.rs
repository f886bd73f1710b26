//! The picture of a plan: one tile for each hand with its best grasp, and one with the contact field.

use nalgebra::{Isometry3, Point3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::mesh::{self, TriangleMesh};
use super::raster::{Buffer, Corner, Pinhole, ShadowMap};
use super::sheet::Sheet;
use super::surface::Surface;
use super::{HandView, Moment, ViewScene, accent, body_poses, certainty_color};

/// Size of a tile's view, pixels.
pub(super) const TILE: [usize; 2] = [470, 380];
/// Height of a tile's caption, pixels.
pub(super) const CAPTION: usize = 54;
/// Space between tiles, pixels.
const GAP: usize = 8;
/// Tiles in a row.
const COLUMNS: usize = 4;
/// Pixels of the renderer along a pixel of the picture.
const FINE: usize = 2;

const BACKGROUND: [f32; 3] = [0.010, 0.013, 0.018];

/// Why there is no picture.
#[derive(Debug, thiserror::Error)]
pub(crate) enum PictureError {
    /// A contact field has no camera to look from.
    #[error("a picture needs a depth image; a contact field alone can be drawn as a page (--page)")]
    NoFrame,
    /// The PNG cannot be written.
    #[error("the picture cannot be encoded: {0}")]
    Encoding(#[from] png::EncodingError),
}

/// Draws the best grasp of every hand; the bytes of a PNG file.
///
/// # Errors
/// [`PictureError`].
pub(crate) fn render(scene: &ViewScene, hands: &[HandView<'_>]) -> Result<Vec<u8>, PictureError> {
    let stage = Stage::new(scene).ok_or(PictureError::NoFrame)?;
    let tiles: Vec<Tile> = (0..=hands.len())
        .into_par_iter()
        .map(|i| hands.get(i).map_or_else(|| stage.field_tile(scene), |view| stage.hand_tile(i, view)))
        .collect();
    let columns = COLUMNS.min(tiles.len());
    let rows = tiles.len().div_ceil(columns);
    let mut sheet = Sheet::new(columns * (TILE[0] + GAP) + GAP, rows * (TILE[1] + CAPTION + GAP) + GAP);
    for (i, tile) in tiles.iter().enumerate() {
        sheet.place(tile, GAP + i % columns * (TILE[0] + GAP), GAP + i / columns * (TILE[1] + CAPTION + GAP));
    }
    sheet.to_png()
}

/// A finished tile: its view, and what is written under it.
pub(super) struct Tile {
    /// The view, linear colours.
    pub(super) pixels: Vec<[f32; 3]>,
    /// Large, on the left.
    pub(super) title: String,
    /// On the right: a score, or words where there is none.
    pub(super) figure: String,
    /// Small, under the title.
    pub(super) detail: String,
    /// Of the stripe between view and caption.
    pub(super) color: [f32; 3],
}

/// The scene, drawn once; each tile starts from a copy.
struct Stage {
    camera: Pinhole,
    buffer: Buffer,
    shadows: ShadowMap,
    eye: Point3<f64>,
}

impl Stage {
    fn new(scene: &ViewScene) -> Option<Self> {
        let frame = scene.frame.as_ref()?;
        let up = scene.up();
        let target = scene.middle() + up * 0.095;
        let eye = lowered(&Point3::from(scene.world_from_camera.translation.vector), &target, &up);
        let camera = look(&eye, &target, &(scene.world_from_camera.rotation * -Vector3::y()));
        // From above, to the left of the camera and towards it.
        let left = scene.world_from_camera.rotation * -Vector3::x();
        let to_light = Unit::new_normalize(up * 1.0 + left * 0.55 + (eye - target).normalize() * 0.25);
        let mut shadows = ShadowMap::new(target, 0.45, 1024, to_light, Unit::new_normalize(up));
        let mut buffer = Buffer::new(TILE[0] * FINE, TILE[1] * FINE);
        let surface = Surface::new(frame, &scene.world_from_camera, 1);
        let table = scene.middle();
        let color = |p: &Point3<f64>| ground_color((p - table).dot(&up));
        for t in surface.triangles(&eye) {
            let [Some(a), Some(b), Some(c)] = t.map(|i| surface.points[i as usize]) else { continue };
            let corner = |p: Point3<f64>, i: u32| Corner {
                point: p,
                normal: surface.normals[i as usize],
                color: color(&p),
            };
            buffer.triangle(&camera, &[corner(a, t[0]), corner(b, t[1]), corner(c, t[2])]);
            shadows.add([a, b, c]);
        }
        Some(Self { camera, buffer, shadows, eye })
    }

    fn hand_tile(&self, index: usize, view: &HandView<'_>) -> Tile {
        let color = accent(index);
        let title = view.hand.display_name.clone();
        let Some(best) = view.outcome.grasps.first() else {
            let reason = view.outcome.no_grasp.as_ref().map_or("not planned", |(reason, _)| reason);
            let pixels = self.finish(&self.buffer, &self.shadows, &[]);
            return Tile {
                pixels,
                title,
                figure: "no grasp".into(),
                detail: reason.replace('_', " "),
                color,
            };
        };
        let mut buffer = self.buffer.clone();
        let mut shadows = self.shadows.clone();
        let poses = body_poses(view.hand, best, Moment::Contact);
        for (body, (mesh, pose)) in mesh::of_hand(view.hand).iter().zip(&poses).enumerate() {
            let tint = if body == 0 { [0.085, 0.095, 0.11] } else { color };
            self.draw(&mut buffer, &mut shadows, mesh, pose, tint);
        }
        let mut dots: Vec<Dot> = best
            .contacts
            .iter()
            .map(|c| Dot { point: c.point, radius: 4.6, color: [0.98, 0.90, 0.25], always: true })
            .collect();
        dots.push(Dot { point: best.centroid, radius: 3.2, color: [0.95, 0.95, 0.95], always: true });
        let detail = format!(
            "{}, {}",
            count(view.outcome.grasps.len(), "grasp"),
            count(best.contacts.len(), "contact")
        );
        Tile {
            pixels: self.finish(&buffer, &shadows, &dots),
            title,
            figure: format!("{:.2}", best.score),
            detail,
            color,
        }
    }

    fn field_tile(&self, scene: &ViewScene) -> Tile {
        let mut dots: Vec<Dot> = scene
            .contacts
            .iter()
            .map(|c| Dot { point: c.point, radius: 1.9, color: certainty_color(c.certainty), always: false })
            .collect();
        dots.extend(scene.centroids.iter().map(|(point, _)| Dot {
            point: *point,
            radius: 5.0,
            color: [0.10, 0.75, 0.95],
            always: true,
        }));
        Tile {
            pixels: self.finish(&self.buffer, &self.shadows, &dots),
            title: "Contact field".into(),
            figure: String::new(),
            detail: format!(
                "{}, {}",
                count(scene.contacts.len(), "focal contact"),
                count(scene.centroids.len(), "centroid")
            ),
            color: certainty_color(0.7),
        }
    }

    fn draw(
        &self,
        buffer: &mut Buffer,
        shadows: &mut ShadowMap,
        mesh: &TriangleMesh,
        pose: &Isometry3<f64>,
        color: [f32; 3],
    ) {
        let world: Vec<Point3<f64>> = mesh.vertices.iter().map(|p| pose * p).collect();
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|i| world[i as usize]);
            let Some(mut normal) = (b - a).cross(&(c - a)).try_normalize(1e-15) else { continue };
            if normal.dot(&(self.eye - a)) < 0.0 {
                normal = -normal;
            }
            buffer.triangle(&self.camera, &[a, b, c].map(|point| Corner { point, normal, color }));
            shadows.add([a, b, c]);
        }
    }

    /// Lights the view, makes it smaller, and sets dots on it.
    fn finish(&self, buffer: &Buffer, shadows: &ShadowMap, dots: &[Dot]) -> Vec<[f32; 3]> {
        let mut fine = buffer.shade(&self.camera, shadows, BACKGROUND);
        for dot in dots {
            let Some([u, v, z]) = self.camera.project(&dot.point) else { continue };
            if dot.always || buffer.shows(u, v, z) {
                disc(&mut fine, buffer.width, buffer.height, [u, v], dot);
            }
        }
        let mut out = Vec::with_capacity(TILE[0] * TILE[1]);
        for y in 0..TILE[1] {
            for x in 0..TILE[0] {
                let mut sum = [0f32; 3];
                for k in 0..FINE * FINE {
                    let pixel = fine[(y * FINE + k / FINE) * buffer.width + x * FINE + k % FINE];
                    (0..3).for_each(|c| sum[c] += pixel[c].min(1.0));
                }
                out.push(sum.map(|s| s / (FINE * FINE) as f32));
            }
        }
        out
    }
}

/// A mark at a point of the world.
struct Dot {
    point: Point3<f64>,
    /// Pixels of the picture.
    radius: f64,
    color: [f32; 3],
    /// Also shown where something hides the point.
    always: bool,
}

fn disc(pixels: &mut [[f32; 3]], width: usize, height: usize, [u, v]: [f64; 2], dot: &Dot) {
    let (radius, border) = (dot.radius * FINE as f64, if dot.always { 1.6 * FINE as f64 } else { 0.0 });
    let reach = (radius + border) as i64 + 1;
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            let (x, y) = (u.round() as i64 + dx, v.round() as i64 + dy);
            if x < 0 || y < 0 || x >= width as i64 || y >= height as i64 {
                continue;
            }
            let d = (dx as f64).hypot(dy as f64);
            if d <= radius + border {
                pixels[y as usize * width + x as usize] =
                    if d <= radius { dot.color } else { [0.02, 0.02, 0.02] };
            }
        }
    }
}

/// Largest elevation that a picture is taken from, radians: from higher up palms hide their fingers.
const HIGHEST: f64 = 0.72;

/// The camera's place, or one straight below it at the same distance where it stands too high. What the
/// camera could not see lies behind objects and stays hidden from there.
fn lowered(eye: &Point3<f64>, target: &Point3<f64>, up: &Vector3<f64>) -> Point3<f64> {
    let out = eye - target;
    let level = out - up * out.dot(up);
    match level.try_normalize(1e-6) {
        Some(level) if out.dot(up) > out.norm() * HIGHEST.sin() => {
            target + (level * HIGHEST.cos() + up * HIGHEST.sin()) * out.norm()
        }
        _ => *eye,
    }
}

/// A camera at `eye` whose picture's middle is `target`, zoomed on what the planner looks at.
fn look(eye: &Point3<f64>, target: &Point3<f64>, up: &Vector3<f64>) -> Pinhole {
    let z = (target - eye).normalize();
    let x = z.cross(up).try_normalize(1e-9).unwrap_or_else(|| z.cross(&Vector3::x()).normalize());
    let y = z.cross(&x);
    let rotation = Rotation3::from_basis_unchecked(&[x, y, z]);
    let pose = Isometry3::from_parts(
        Translation3::from(eye.coords),
        UnitQuaternion::from_rotation_matrix(&rotation),
    );
    let half_height_m = 0.215;
    Pinhole {
        focal_px: (TILE[1] * FINE) as f64 / 2.0 * (target - eye).norm() / half_height_m,
        center_px: [(TILE[0] * FINE) as f64 / 2.0 - 0.5, (TILE[1] * FINE) as f64 / 2.0 - 0.5],
        camera_from_world: pose.inverse(),
    }
}

/// Table grey, objects from blue-grey to sand with their height above it.
fn ground_color(height_m: f64) -> [f32; 3] {
    let mix =
        |a: [f32; 3], b: [f32; 3], t: f64| [0, 1, 2].map(|k| a[k] + (b[k] - a[k]) * t.clamp(0.0, 1.0) as f32);
    let (table, low, high) = ([0.36, 0.37, 0.38], [0.42, 0.53, 0.62], [0.80, 0.72, 0.55]);
    mix(table, mix(low, high, (height_m - 0.02) / 0.11), (height_m - 0.004) / 0.006)
}

fn count(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::fixtures;

    #[test]
    fn a_picture_shows_the_hand_where_it_is() {
        let (scene, hand, outcome) = (fixtures::toy_scene(), fixtures::toy_hand(), fixtures::toy_outcome());
        let stage = Stage::new(&scene).unwrap();
        let view = HandView { hand: &hand, outcome: &outcome };
        let with = stage.hand_tile(0, &view);
        let without = stage.finish(&stage.buffer, &stage.shadows, &[]);
        // The palm's middle, seen from the camera.
        let palm = outcome.grasps[0].world_from_hand * Point3::new(0.0, 0.0, 0.0);
        let [u, v, _] = stage.camera.project(&palm).unwrap();
        let i = (v as usize / FINE) * TILE[0] + u as usize / FINE;
        assert_ne!(with.pixels[i], without[i]);
        assert_eq!(with.figure, "0.81");
    }

    #[test]
    fn a_sheet_is_a_png_of_the_expected_size() {
        let (scene, hand, outcome) = (fixtures::toy_scene(), fixtures::toy_hand(), fixtures::toy_outcome());
        let bytes = render(&scene, &[HandView { hand: &hand, outcome: &outcome }]).unwrap();
        let reader = png::Decoder::new(std::io::Cursor::new(&bytes)).read_info().unwrap();
        let expected = (2 * (TILE[0] + GAP) + GAP, TILE[1] + CAPTION + 2 * GAP);
        assert_eq!((reader.info().width as usize, reader.info().height as usize), expected);
        if let Some(path) = std::env::var_os("GRASPD_TEST_PICTURE") {
            std::fs::write(path, bytes).unwrap();
        }
    }

    #[test]
    fn a_contact_field_alone_has_no_picture() {
        let scene = ViewScene { frame: None, ..fixtures::toy_scene() };
        assert!(matches!(render(&scene, &[]), Err(PictureError::NoFrame)));
    }
}
