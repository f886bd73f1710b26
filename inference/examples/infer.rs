//! Runs a model on a volume: `infer MODEL.onnx VOLUME.f32 OUTPUT.f32 [RUNS] [THREADS]`.
//!
//! Both files hold 32-bit little-endian numbers: the volume in memory order, the output certainties, then centroids,
//! then orientations voxel by voxel. Prints the milliseconds of each run. Used to compare with other runtimes.

use std::error::Error;
use std::time::Instant;

use graspd_inference::{Network, Orientations};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [model, volume, output, rest @ ..] = &arguments[..] else {
        return Err("usage: infer MODEL.onnx VOLUME.f32 OUTPUT.f32 [RUNS] [THREADS]".into());
    };
    let runs = rest.first().map_or(Ok(1), |r| r.parse())?;
    let threads = rest.get(1).map_or(Ok(0), |t| t.parse())?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let network = Network::from_bytes(&std::fs::read(model)?)?;
    let bytes = std::fs::read(volume)?;
    let volume: Vec<f32> = bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();

    let mut answer = pool.install(|| network.run(&volume))?;
    for _ in 0..runs {
        let began = Instant::now();
        answer = pool.install(|| network.run(&volume))?;
        println!("{:.3}", began.elapsed().as_secs_f64() * 1e3);
    }

    let orientation = match &answer.orientation {
        Orientations::Quaternion(all) => all.as_flattened(),
        Orientations::R6d(all) => all.as_flattened(),
    };
    let numbers = answer.certainty.iter().chain(&answer.centroid).chain(orientation);
    std::fs::write(output, numbers.flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>())?;
    Ok(())
}
