//! The layers that a network consists of once its batch norms, sums and activations are folded into convolutions.

use rayon::prelude::*;

use crate::kernel::{CHUNK, Isa, LANES, Lane, Row};
use crate::tensor::Shape;

/// Which activations a layer reads or writes.
pub(crate) type Slot = usize;

/// One step of a network.
#[derive(Debug)]
pub(crate) enum Layer {
    /// A convolution with all that happens to its result.
    Conv(Conv),
    /// The greatest of 2³ cells.
    Pool { input: Slot, output: Slot },
    /// Channels of two tensors, one after the other.
    Concat { inputs: [Slot; 2], output: Slot },
}

/// How a convolution goes over its input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Walk {
    /// Each output cell reads `kernel`³ cells from `stride` times its place, less `pad`, on.
    Window { kernel: usize, stride: usize, pad: usize },
    /// Each input cell makes 2³ output cells (a transposed convolution with kernel and stride 2).
    Spread,
}

/// Weights of up to two blocks of channels, as the kernel reads them.
#[derive(Debug)]
pub(crate) struct Group {
    first_block: usize,
    weights: Vec<Lane>,
    bias: Vec<Lane>,
}

/// A convolution; what is added, and whether negative results become 0.
#[derive(Debug)]
pub(crate) struct Conv {
    pub(crate) input: Slot,
    pub(crate) output: Slot,
    pub(crate) residual: Option<Slot>,
    pub(crate) relu: bool,
    pub(crate) walk: Walk,
    /// For each of the 2³ places of [`Walk::Spread`], or once.
    pub(crate) parts: Vec<Vec<Group>>,
}

/// The last convolution: its channels go to separate arrays in memory order, scores through a sigmoid.
#[derive(Debug)]
pub(crate) struct Head {
    pub(crate) input: Slot,
    /// Voxels along an edge that a cell answers for, 1 or 2.
    pub(crate) shuffle: usize,
    /// Numbers of the orientation.
    pub(crate) numbers: usize,
    pub(crate) groups: Vec<Group>,
}

/// Packs weights for the kernel: `weight(output, row, input)` for `rows` rows of `inputs` inputs.
pub(crate) fn pack(
    isa: Isa,
    outputs: usize,
    rows: usize,
    inputs: usize,
    weight: impl Fn(usize, usize, usize) -> f32,
    bias: impl Fn(usize) -> f32,
) -> Vec<Group> {
    let blocks = outputs.div_ceil(LANES);
    let together = if isa.two_blocks() { 2 } else { 1 };
    let lane = |block: usize, value: &dyn Fn(usize) -> f32| -> Lane {
        std::array::from_fn(|l| if block * LANES + l < outputs { value(block * LANES + l) } else { 0.0 })
    };
    (0..blocks)
        .step_by(together)
        .map(|first_block| {
            let of_group = first_block..(first_block + together).min(blocks);
            let mut weights = Vec::with_capacity(rows * inputs * of_group.len());
            for row in 0..rows {
                for input in 0..inputs {
                    weights.extend(of_group.clone().map(|b| lane(b, &|output| weight(output, row, input))));
                }
            }
            let bias = of_group.map(|b| lane(b, &bias)).collect();
            Group { first_block, weights, bias }
        })
        .collect()
}

/// A tensor that is read.
#[derive(Clone, Copy)]
pub(crate) struct Read<'a> {
    pub(crate) shape: Shape,
    pub(crate) values: &'a [f32],
}

impl Conv {
    /// Computes the whole output.
    pub(crate) fn run(
        &self,
        isa: Isa,
        input: Read<'_>,
        residual: Option<Read<'_>>,
        shape: Shape,
        output: &mut [f32],
    ) {
        output.par_chunks_exact_mut(shape.plane()).skip(shape.margin).take(shape.side).enumerate().for_each(
            |(x, plane)| match self.walk {
                Walk::Window { kernel, stride, pad } => {
                    self.window(isa, [kernel, stride, pad], input, residual, shape, x, plane);
                }
                Walk::Spread => self.spread(isa, input, residual, shape, x, plane),
            },
        );
    }

    #[allow(clippy::too_many_arguments)]
    fn window(
        &self,
        isa: Isa,
        [kernel, stride, pad]: [usize; 3],
        input: Read<'_>,
        residual: Option<Read<'_>>,
        shape: Shape,
        x: usize,
        plane: &mut [f32],
    ) {
        let mut rows = Vec::with_capacity(kernel * kernel);
        for group in self.parts.iter().flatten() {
            let channel = group.first_block * LANES;
            for y in 0..shape.side {
                rows.clear();
                for tap in 0..kernel * kernel {
                    rows.push(input.shape.window(x * stride, y * stride, [tap / kernel, tap % kernel], pad));
                }
                Row {
                    input: input.values,
                    rows: &rows,
                    inputs: kernel * input.shape.stride,
                    step: stride * input.shape.stride,
                    weights: &group.weights,
                    bias: &group.bias,
                    residual: residual.map(|r| (r.values, r.shape.index(x, y, 0) + channel, r.shape.stride)),
                    relu: self.relu,
                    output: &mut plane[shape.in_plane(y, 0) + channel..],
                    output_step: shape.stride,
                    voxels: shape.side,
                }
                .compute(isa);
            }
        }
    }

    fn spread(
        &self,
        isa: Isa,
        input: Read<'_>,
        residual: Option<Read<'_>>,
        shape: Shape,
        x: usize,
        plane: &mut [f32],
    ) {
        for (place, groups) in self.parts.iter().enumerate().skip(x % 2 * 4).take(4) {
            let (dy, dz) = (place / 2 % 2, place % 2);
            for group in groups {
                let channel = group.first_block * LANES;
                for y in 0..input.shape.side {
                    let at = |r: Read<'_>| r.shape.index(x, 2 * y + dy, dz) + channel;
                    Row {
                        input: input.values,
                        rows: &[input.shape.index(x / 2, y, 0)],
                        inputs: input.shape.stride,
                        step: input.shape.stride,
                        weights: &group.weights,
                        bias: &group.bias,
                        residual: residual.map(|r| (r.values, at(r), 2 * r.shape.stride)),
                        relu: self.relu,
                        output: &mut plane[shape.in_plane(2 * y + dy, dz) + channel..],
                        output_step: 2 * shape.stride,
                        voxels: input.shape.side,
                    }
                    .compute(isa);
                }
            }
        }
    }
}

impl Head {
    /// Computes scores and orientations, each in memory order; `orientation` has `numbers` per voxel.
    pub(crate) fn run(&self, isa: Isa, input: Read<'_>, scores: [&mut [f32]; 2], orientation: &mut [f32]) {
        let (cells, s) = (input.shape.side, self.shuffle);
        let side = cells * s;
        let slab = s * side * side;
        let channels = 2 + self.numbers;
        let stride = (s * s * s * channels).next_multiple_of(LANES);
        let [certainty, centroid] = scores;
        let slabs = certainty
            .par_chunks_exact_mut(slab)
            .zip(centroid.par_chunks_exact_mut(slab))
            .zip(orientation.par_chunks_exact_mut(slab * self.numbers));
        slabs.enumerate().for_each(|(x, ((certainty, centroid), orientation))| {
            let mut row = vec![0.0; cells * stride];
            for y in 0..cells {
                for group in &self.groups {
                    Row {
                        input: input.values,
                        rows: &[input.shape.index(x, y, 0)],
                        inputs: input.shape.stride,
                        step: input.shape.stride,
                        weights: &group.weights,
                        bias: &group.bias,
                        residual: None,
                        relu: false,
                        output: &mut row[group.first_block * LANES..],
                        output_step: stride,
                        voxels: cells,
                    }
                    .compute(isa);
                }
                for (z, answers) in row.chunks_exact(stride).enumerate() {
                    for (place, answer) in answers.chunks_exact(channels).take(s * s * s).enumerate() {
                        let (dx, dy, dz) = (place / (s * s), place / s % s, place % s);
                        let voxel = (dx * side + y * s + dy) * side + z * s + dz;
                        certainty[voxel] = answer[0];
                        centroid[voxel] = answer[1];
                        orientation[voxel * self.numbers..][..self.numbers].copy_from_slice(&answer[2..]);
                    }
                }
            }
            sigmoid(certainty);
            sigmoid(centroid);
        });
    }
}

/// The logistic function of each value.
fn sigmoid(values: &mut [f32]) {
    for value in values {
        *value = 1.0 / (1.0 + (-*value).exp());
    }
}

/// The greatest of each 2³ cells.
pub(crate) fn pool(input: Read<'_>, shape: Shape, output: &mut [f32]) {
    output.par_chunks_exact_mut(shape.plane()).skip(shape.margin).take(shape.side).enumerate().for_each(
        |(x, plane)| {
            for y in 0..shape.side {
                for z in 0..shape.side {
                    let to = &mut plane[shape.in_plane(y, z)..][..shape.stride];
                    to.fill(f32::NEG_INFINITY);
                    for place in 0..8 {
                        let from =
                            input.shape.index(2 * x + place / 4, 2 * y + place / 2 % 2, 2 * z + place % 2);
                        for (greatest, value) in to.iter_mut().zip(&input.values[from..][..shape.stride]) {
                            *greatest = greatest.max(*value);
                        }
                    }
                }
            }
        },
    );
}

/// Channels of both inputs, one after the other.
pub(crate) fn concat(inputs: [Read<'_>; 2], shape: Shape, output: &mut [f32]) {
    output.par_chunks_exact_mut(shape.plane()).skip(shape.margin).take(shape.side).enumerate().for_each(
        |(x, plane)| {
            for y in 0..shape.side {
                for z in 0..shape.side {
                    let mut to = &mut plane[shape.in_plane(y, z)..][..shape.stride];
                    for input in inputs {
                        let (here, rest) = to.split_at_mut(input.shape.channels);
                        here.copy_from_slice(&input.values[input.shape.index(x, y, z)..][..here.len()]);
                        to = rest;
                    }
                }
            }
        },
    );
}

/// Lays a volume out as activations: cells of `block`³ voxels, a voxel a channel.
pub(crate) fn load(volume: &[f32], block: usize, shape: Shape, output: &mut [f32]) {
    let side = shape.side * block;
    output.par_chunks_exact_mut(shape.plane()).skip(shape.margin).take(shape.side).enumerate().for_each(
        |(x, plane)| {
            for y in 0..shape.side {
                let row = &mut plane[shape.in_plane(y, 0)..][..shape.side * shape.stride];
                for channel in 0..block.pow(3) {
                    let (dx, dy, dz) = (channel / (block * block), channel / block % block, channel % block);
                    let from = &volume[((x * block + dx) * side + y * block + dy) * side..][..side];
                    for (cell, value) in
                        row.chunks_exact_mut(shape.stride).zip(from.iter().skip(dz).step_by(block))
                    {
                        cell[channel] = *value;
                    }
                }
            }
        },
    );
}

/// The shape of a volume that [`load`] lays out.
pub(crate) fn loaded(side: usize, block: usize) -> Shape {
    Shape { side: side / block, channels: block.pow(3), stride: CHUNK, margin: 0 }
}
