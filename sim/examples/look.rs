//! A poured tray, or a scene file, as pictures (portable pixmaps, PPM) and as a scene file:
//! `cargo run --release -p graspd-sim --example look -- FOLDER [SEED | SCENE.json]`.
//!
//! `scene.ppm` is for people; `kinect.ppm` and `flexx.ppm` are depth images in false colour, exact on the left and
//! with the camera's faults on the right.

use std::io::Write;
use std::path::Path;

use graspd_sim::camera::{Pinhole, look_at};
use graspd_sim::clutter::{ArrangeError, Arrangement, arrange, assortment};
use graspd_sim::render::{RgbImage, capture, depth_picture, picture};
use graspd_sim::scene;
use graspd_sim::sensor::Sensor;
use graspd_sim::world::{Tray, World, WorldSettings};
use nalgebra::{Point3, Vector3};

/// Objects in the tray, as in the paper's Task 2.
const OBJECTS: usize = 12;
/// Depths between the two ends of the colours, metres.
const RANGE_M: [f64; 2] = [0.5, 0.9];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut words = std::env::args().skip(1);
    let folder = words.next().unwrap_or_else(|| ".".into());
    let folder = Path::new(&folder);
    std::fs::create_dir_all(folder)?;
    let world = match words.next() {
        Some(word) => match word.parse() {
            Ok(seed) => poured(seed)?,
            Err(_) => scene::from_json(&std::fs::read_to_string(word)?)?,
        },
        None => poured(5)?,
    };
    std::fs::write(folder.join("scene.json"), scene::to_json(&world))?;

    let target = Point3::new(0.0, 0.0, 0.03);
    let lens = Pinhole { width: 840, height: 600, fx_px: 860.0, fy_px: 860.0, cx_px: 419.5, cy_px: 299.5 };
    let front = look_at(&Point3::new(0.31, -0.39, 0.43), &Point3::new(0.0, -0.02, 0.01), &Vector3::z());
    save(&folder.join("scene.ppm"), &picture(&world, &lens, &front))?;

    let above = look_at(&Point3::new(0.0, -0.2, 0.65), &target, &Vector3::z());
    for (name, sensor) in [("kinect", Sensor::azure_kinect()), ("flexx", Sensor::pico_flexx())] {
        let view = capture(&world, &sensor.lens, &above);
        let exact = depth_picture(&Sensor::ideal(sensor.lens).observe(&view, 0), RANGE_M);
        let seen = depth_picture(&sensor.observe(&view, 1), RANGE_M);
        save(&folder.join(format!("{name}.ppm")), &beside(&exact, &seen))?;
    }
    Ok(())
}

fn poured(seed: u64) -> Result<World, ArrangeError> {
    let settings = WorldSettings { tray: Some(Tray::default()), ..WorldSettings::default() };
    arrange(&settings, &assortment(OBJECTS, seed), Arrangement::Pile, seed)
}

/// Two pictures of one size side by side.
fn beside(left: &RgbImage, right: &RgbImage) -> RgbImage {
    let rows = left.pixels.chunks(left.width).zip(right.pixels.chunks(right.width));
    let pixels = rows.flat_map(|(left, right)| left.iter().chain(right)).copied().collect();
    RgbImage { width: left.width + right.width, height: left.height, pixels }
}

fn save(path: &Path, image: &RgbImage) -> std::io::Result<()> {
    let mut file = std::io::BufWriter::new(std::fs::File::create(path)?);
    write!(file, "P6\n{} {}\n255\n", image.width, image.height)?;
    file.write_all(image.pixels.as_flattened())
}
