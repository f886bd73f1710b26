//! Pictures of a run, taken from the simulated world at even steps of its clock.

use std::path::{Path, PathBuf};
use std::sync::mpsc;

use anyhow::Context as _;
use graspd_adapters_mock::SharedWorld;
use graspd_sim::camera::{Pinhole, look_at};
use graspd_sim::render;
use nalgebra::{Point3, Vector3};

/// Size, pixels.
const SIZE: (usize, usize) = (720, 480);

fn write(path: &Path, picture: &render::RgbImage) -> anyhow::Result<()> {
    let file = std::io::BufWriter::new(std::fs::File::create(path)?);
    let mut encoder = png::Encoder::new(file, u32::try_from(picture.width)?, u32::try_from(picture.height)?);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_compression(png::Compression::High);
    encoder.write_header()?.write_image_data(picture.pixels.as_flattened())?;
    Ok(())
}

/// Where the pictures are taken from, what they look at, and how long the lens is, pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Viewpoint {
    pub(super) eye: Point3<f64>,
    pub(super) target: Point3<f64>,
    pub(super) focal_px: f64,
}

/// Takes a picture every so many simulated seconds from now on, as long as the world lives: `0000.png` and so on.
pub(super) async fn take(
    shared: &SharedWorld,
    folder: &Path,
    every_s: f64,
    from: Viewpoint,
) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
    let folder: PathBuf = folder.to_owned();
    let (send, pictures) = mpsc::channel::<render::RgbImage>();
    std::thread::spawn(move || {
        for (i, picture) in pictures.iter().enumerate() {
            let path = folder.join(format!("{i:04}.png"));
            if let Err(error) = write(&path, &picture) {
                tracing::warn!(%error, "a picture is missing");
            }
        }
    });
    let lens = Pinhole {
        width: SIZE.0,
        height: SIZE.1,
        fx_px: from.focal_px,
        fy_px: from.focal_px,
        cx_px: SIZE.0 as f64 / 2.0,
        cy_px: SIZE.1 as f64 / 2.0,
    };
    let eye = look_at(&from.eye, &from.target, &Vector3::z());
    shared
        .watch(every_s, move |world| {
            // Nobody takes pictures any more only when the program ends.
            send.send(render::picture(world, &lens, &eye)).ok();
        })
        .await?;
    Ok(())
}
