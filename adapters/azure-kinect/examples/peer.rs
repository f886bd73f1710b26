//! What independent software is compared with; `tests/peers/azure_kinect.sh` runs it.
//!
//! - `peer images FILE`: one line for each image of a recording: channel, device time in µs, two checksums.
//! - `peer record FILE MODE FRAMES`: writes a made-up recording; its images are those of `images`.
//! - `peer rays CALIBRATION MODE OUT`: the ray of every depth pixel, `f32` pairs, and the lens on the standard output.
//! - `peer color CALIBRATION MODE`: lines `u v mm` of the depth image in, lines `u v` of the 720P colour image out.
//! - `peer check LIBRARY`: what the adapter finds about that library.

use std::error::Error;
use std::io::BufRead;
use std::path::Path;
use std::time::Duration;

use graspd_adapters_azure_kinect::calibration::{Calibration, EXAMPLE};
use graspd_adapters_azure_kinect::lens::points;
use graspd_adapters_azure_kinect::mkv::write::{Header, Recorder};
use graspd_adapters_azure_kinect::mode::{ColorResolution, DepthMode};
use graspd_adapters_azure_kinect::recording::Recording;
use graspd_adapters_azure_kinect::settings::{DeviceSettings, KinectSettings, Source};
use graspd_adapters_azure_kinect::{Finding, KinectCamera};

type Outcome = Result<(), Box<dyn Error>>;

fn main() -> Outcome {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        ["images", file] => images(file),
        ["record", file, mode, frames] => record(file, named(mode)?, frames.parse()?),
        ["rays", calibration, mode, out] => rays(&read(calibration)?, named(mode)?, out),
        ["color", calibration, mode] => color(&read(calibration)?, named(mode)?),
        ["check", library] => check(library),
        _ => Err("see the first lines of this example".into()),
    }
}

fn named(mode: &str) -> Result<DepthMode, String> {
    DepthMode::from_tag(mode).ok_or_else(|| format!("{mode}: no depth mode"))
}

/// A calibration's file, or the built-in one.
fn read(path: &str) -> Result<Calibration, Box<dyn Error>> {
    let text = if path == "example" { EXAMPLE.as_bytes().to_vec() } else { std::fs::read(path)? };
    Ok(Calibration::from_json(&text)?)
}

/// Two sums that depend on every value and its place.
fn sums(values: &[u16]) -> (u64, u64) {
    let plain = values.iter().map(|v| u64::from(*v)).sum();
    let placed = values.iter().zip(1u64..).fold(0u64, |sum, (v, i)| sum.wrapping_add(u64::from(*v) * i));
    (plain, placed)
}

fn images(file: &str) -> Outcome {
    let mut recording = Recording::open(file.as_ref())?;
    while let Some(image) = recording.next_image()? {
        let (plain, placed) = sums(&image.values);
        println!("{:?} {} {plain} {placed}", image.channel, image.stamp.as_micros());
    }
    Ok(())
}

fn record(file: &str, mode: DepthMode, frames: u64) -> Outcome {
    let (width, height) = mode.size();
    let header = Header {
        mode,
        frame_ns: 66_666_666,
        start_offset_ns: 1_500_000_000,
        calibration: EXAMPLE,
        serial: "000123456789",
    };
    let mut recorder = Recorder::new(&header);
    for n in 0..frames {
        let value = |i: usize, salt: usize| ((i * 31 + n as usize * 977 + salt) % 5000) as u16;
        let depth: Vec<u16> = (0..width * height).map(|i| value(i, 0)).collect();
        let infrared: Vec<u16> = (0..width * height).map(|i| value(i, 77)).collect();
        recorder.push(n * 66_667, &depth, &infrared);
    }
    std::fs::write(file, recorder.finish())?;
    images(file)
}

fn rays(calibration: &Calibration, mode: DepthMode, out: &str) -> Outcome {
    let lens = calibration.depth_lens(mode);
    let rays = lens.rays();
    // The points of a metre's depth are what a point cloud has.
    let cloud = points(&rays, &vec![1000; rays.len()]);
    let seen = cloud.iter().filter(|p| p[2] > 0.0).count();
    eprintln!("{}: {seen} of {} pixels see something", mode.label(), rays.len());
    let bytes: Vec<u8> = rays.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    std::fs::write(out, bytes)?;
    let [cx, cy, fx, fy] = [lens.c[0], lens.c[1], lens.f[0], lens.f[1]];
    println!("{cx} {cy} {fx} {fy}");
    Ok(())
}

fn color(calibration: &Calibration, mode: DepthMode) -> Outcome {
    let lens = calibration.depth_lens(mode);
    let Some(color) = calibration.color_lens(ColorResolution::P720) else {
        return Err("no colour camera".into());
    };
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        let values: Vec<f64> = line.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
        let [u, v, mm] = values[..] else { return Err(line.into()) };
        let z = mm * 1e-3;
        let point = lens.unproject([u, v]).map(|[x, y]| [x * z, y * z, z]);
        let pixel = point.and_then(|p| calibration.color_from_depth(p)).and_then(|p| color.project(p));
        match pixel {
            Some([u, v]) => println!("{u} {v}"),
            None => println!("none"),
        }
    }
    Ok(())
}

#[tokio::main(flavor = "current_thread")]
async fn check(library: &str) -> Outcome {
    let device = DeviceSettings { library: Some(Path::new(library).into()), ..DeviceSettings::default() };
    let settings = KinectSettings { source: Source::Device(device), ..KinectSettings::default() };
    let camera = KinectCamera::new(settings).await?;
    for finding in camera.check(Duration::from_secs(20)).await {
        let Finding { subject, ok, found, advice } = finding;
        if ok {
            println!("good {subject}: {found}");
        } else {
            println!("bad {subject}: {found} -> {advice}");
        }
    }
    Ok(())
}
