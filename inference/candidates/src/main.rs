//! Times of other ways to run a network in Rust: `candidates tract|gemm MODEL.onnx VOLUME.f32 RUNS THREADS`.
//!
//! `tract` runs the ONNX file with tract and its multithreaded matrix kernels. `gemm` does what our network's
//! convolutions would cost as products of matrices: patches are copied out plane by plane (im2row) and multiplied with the
//! weights by the `gemm` crate; nothing else of the network is done, so its times are lower bounds.

use std::time::Instant;

use rayon::prelude::*;
use tract_onnx::prelude::*;

type Any = Box<dyn std::error::Error>;

fn main() -> Result<(), Any> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [which, model, volume, runs, threads] = &arguments[..] else {
        return Err("usage: candidates tract|gemm MODEL.onnx VOLUME.f32 RUNS THREADS".into());
    };
    let (runs, threads): (usize, usize) = (runs.parse()?, threads.parse()?);
    let bytes = std::fs::read(volume)?;
    let volume: Vec<f32> = bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    match which.as_str() {
        "tract" => tract(model, &volume, runs, threads),
        "gemm" => gemm(runs, threads),
        other => Err(format!("found {other}, expected tract or gemm").into()),
    }
}

fn tract(model: &str, volume: &[f32], runs: usize, threads: usize) -> Result<(), Any> {
    let executor = tract_linalg::multithread::Executor::multithread(threads);
    tract_linalg::multithread::multithread_tract_scope(executor, || -> Result<(), Any> {
        let side = (volume.len() as f64).cbrt().round() as usize;
        let model = tract_onnx::onnx().model_for_path(model)?.into_optimized()?.into_runnable()?;
        let input = Tensor::from_shape(&[1, 1, side, side, side], volume)?;
        model.run(tvec!(input.clone().into()))?;
        for _ in 0..runs {
            let began = Instant::now();
            model.run(tvec!(input.clone().into()))?;
            println!("{:.3}", began.elapsed().as_secs_f64() * 1e3);
        }
        Ok(())
    })
}

/// Cells along an edge of the output, taps of the kernel (cubed), input channels, output channels.
const LAYERS: [(usize, usize, usize, usize); 19] = [
    (40, 27, 8, 16),
    (20, 8, 16, 48),
    (20, 27, 48, 48),
    (20, 27, 48, 48),
    (10, 8, 48, 64),
    (10, 27, 64, 64),
    (10, 27, 64, 64),
    (5, 8, 64, 96),
    (5, 27, 96, 96),
    (5, 27, 96, 96),
    (5, 1, 96, 512),
    (10, 27, 64, 64),
    (10, 1, 64, 384),
    (20, 27, 48, 48),
    (20, 1, 48, 128),
    (40, 27, 16, 16),
    (40, 1, 16, 32),
    (40, 1, 8, 32),
    (40, 1, 32, 48),
];

fn gemm(runs: usize, threads: usize) -> Result<(), Any> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let layers = LAYERS.map(|(side, taps, inputs, outputs)| {
        let input = vec![0.5f32; (side + 2).pow(3) * inputs];
        (side, taps, inputs, outputs, input, vec![0.1f32; taps * inputs * outputs])
    });
    for _ in 0..=runs {
        let began = Instant::now();
        pool.install(|| {
            for (side, taps, inputs, outputs, input, weights) in &layers {
                layer(*side, *taps, *inputs, *outputs, input, weights);
            }
        });
        println!("{:.3}", began.elapsed().as_secs_f64() * 1e3);
    }
    Ok(())
}

fn layer(side: usize, taps: usize, inputs: usize, outputs: usize, input: &[f32], weights: &[f32]) -> Vec<f32> {
    let (depth, cells) = (taps * inputs, side * side);
    let kernel = (taps as f64).cbrt().round() as usize;
    let mut output = vec![0.0f32; side * cells * outputs];
    output.par_chunks_exact_mut(cells * outputs).enumerate().for_each_init(Vec::new, |patches, (x, output)| {
        patches.clear();
        for y in 0..side {
            for z in 0..side {
                for tap in 0..kernel * kernel {
                    let row = (x + tap / kernel) * (side + 2) + y + tap % kernel;
                    let from = (row * (side + 2) + z) * inputs;
                    patches.extend_from_slice(&input[from..from + kernel * inputs]);
                }
            }
        }
        // SAFETY: `output` has cells × outputs numbers, `patches` cells × depth, `weights` depth × outputs.
        unsafe {
            gemm::gemm(
                cells, outputs, depth, output.as_mut_ptr(), 1, outputs as isize, false, patches.as_ptr(), 1,
                depth as isize, weights.as_ptr(), 1, outputs as isize, 0.0, 1.0, false, false, false,
                gemm::Parallelism::None,
            );
        }
    });
    output
}
