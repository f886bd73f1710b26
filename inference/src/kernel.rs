//! The inner loop of every layer: a row of output voxels, sixteen output channels at a time.
//!
//! Activations lie channels last, so what one output voxel needs of one row of input voxels is contiguous: a
//! convolution is a short list of such rows, each multiplied with its part of the weights. Results of a few voxels
//! stay in registers until they are whole. There is one kernel, written once for vectors of any width, and built for
//! three instruction sets.

/// Channels that are computed together: a vector register of AVX-512, two of AVX2, four of SSE or NEON.
pub(crate) const LANES: usize = 16;
/// Input channels come in multiples of this.
pub(crate) const CHUNK: usize = 8;

/// One value for each of [`LANES`] channels.
pub(crate) type Lane = [f32; LANES];

/// The instruction set that the kernels run on, found when a network is loaded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Isa {
    /// What every machine of this architecture has.
    Portable,
    /// AVX2 and fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AVX-512.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Isa {
    /// The widest one of this machine.
    pub(crate) fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("fma") {
                return Self::Avx512;
            }
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                return Self::Avx2;
            }
        }
        Self::Portable
    }

    /// All that this machine has.
    #[cfg(test)]
    pub(crate) fn all() -> Vec<Self> {
        let mut all = vec![Self::Portable];
        #[cfg(target_arch = "x86_64")]
        match Self::detect() {
            Self::Avx512 => all.extend([Self::Avx2, Self::Avx512]),
            Self::Avx2 => all.push(Self::Avx2),
            Self::Portable => {}
        }
        all
    }

    /// Whether weights are packed for two blocks of [`LANES`] channels at a time: enough registers for both.
    pub(crate) fn two_blocks(self) -> bool {
        match self {
            Self::Portable => false,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => false,
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => true,
        }
    }
}

/// A row of output voxels, for one group of output channels.
pub(crate) struct Row<'a> {
    /// Input activations.
    pub(crate) input: &'a [f32],
    /// Where in `input` the rows of the first output voxel begin.
    pub(crate) rows: &'a [usize],
    /// Contiguous inputs in each of `rows`: a multiple of [`CHUNK`].
    pub(crate) inputs: usize,
    /// From one output voxel to the next in `input`.
    pub(crate) step: usize,
    /// Weights: for every input of every row, the group's channels.
    pub(crate) weights: &'a [Lane],
    /// Where results begin: one lane for each block of the group.
    pub(crate) bias: &'a [Lane],
    /// What is added to the results: activations, the place of the first voxel, and from one voxel to the next.
    pub(crate) residual: Option<(&'a [f32], usize, usize)>,
    /// Whether negative results become 0.
    pub(crate) relu: bool,
    /// Where results go, from the first voxel's first channel of the group on.
    pub(crate) output: &'a mut [f32],
    /// From one voxel to the next in `output`.
    pub(crate) output_step: usize,
    /// Voxels of the row.
    pub(crate) voxels: usize,
}

impl Row<'_> {
    /// Computes the row.
    pub(crate) fn compute(self, isa: Isa) {
        match isa {
            Isa::Portable => portable::run(self),
            // SAFETY: `Isa::detect` gives these only on machines that have the features named by the functions.
            #[cfg(target_arch = "x86_64")]
            #[allow(unsafe_code)]
            Isa::Avx2 => unsafe { avx2::run(self) },
            #[cfg(target_arch = "x86_64")]
            #[allow(unsafe_code)]
            Isa::Avx512 => unsafe { avx512::run(self) },
        }
    }
}

/// Row after row of tiles of `$w` voxels; the last one reaches back over voxels that are done already if the row does
/// not come out even, and rows shorter than a tile go voxel by voxel.
macro_rules! tiles {
    ($row:ident, $w:literal, $n:literal) => {{
        if $row.voxels < $w {
            for voxel in 0..$row.voxels {
                tile::<1, $n>(&mut $row, voxel);
            }
            return;
        }
        let last = $row.voxels - $w;
        for voxel in (0..$row.voxels).step_by($w) {
            tile::<$w, $n>(&mut $row, voxel.min(last));
        }
    }};
}

/// The kernel of one instruction set, of `W` voxels and `N` blocks of channels, for vectors of `$width` numbers.
macro_rules! tile {
    ($(#[$features:meta])? $vector:ty, $width:literal, $load:ident, $store:ident, $splat:ident, $fused:ident, $add:ident, $greater:ident) => {
        /// Numbers of a lane as vectors.
        const PARTS: usize = LANES / $width;

        /// `W` voxels from `first` on.
        #[inline]
        $(#[$features])?
        fn tile<const W: usize, const N: usize>(row: &mut Row<'_>, first: usize) {
            let (weights, _) = row.weights.as_chunks::<N>();
            let (weights, _) = weights.as_chunks::<CHUNK>();
            let Some(bias) = row.bias.first_chunk::<N>() else { return };
            // Loops instead of `from_fn`: a closure's call is a boundary that vectors would cross through memory.
            let zero = $splat(0.0);
            let mut sums = [[[zero; PARTS]; N]; W];
            for sums in &mut sums {
                for n in 0..N {
                    for p in 0..PARTS {
                        sums[n][p] = $load(&bias[n], p);
                    }
                }
            }
            let chunks = row.inputs / CHUNK;
            for (begin, weights) in row.rows.iter().zip(weights.chunks_exact(chunks)) {
                let place = begin + first * row.step;
                let mut inputs: [&[[f32; CHUNK]]; W] = [&[]; W];
                for v in 0..W {
                    inputs[v] = &row.input[place + v * row.step..].as_chunks().0[..chunks];
                }
                for (chunk, weights) in weights.iter().enumerate() {
                    for i in 0..CHUNK {
                        let mut now = [[zero; PARTS]; N];
                        for n in 0..N {
                            for p in 0..PARTS {
                                now[n][p] = $load(&weights[i][n], p);
                            }
                        }
                        for v in 0..W {
                            let x = $splat(inputs[v][chunk][i]);
                            for n in 0..N {
                                for p in 0..PARTS {
                                    sums[v][n][p] = $fused(x, now[n][p], sums[v][n][p]);
                                }
                            }
                        }
                    }
                }
            }
            for (v, sums) in sums.iter().enumerate() {
                let residual = row.residual.map(|(values, begin, step)| &values[begin + (first + v) * step..]);
                let output = &mut row.output[(first + v) * row.output_step..];
                let (output, _) = output.as_chunks_mut::<LANES>();
                for (n, sums) in sums.iter().enumerate() {
                    let more = residual.map(|r| &r.as_chunks::<LANES>().0[n]);
                    for (p, sum) in sums.iter().enumerate() {
                        let sum = more.map_or(*sum, |more| $add(*sum, $load(more, p)));
                        $store(&mut output[n], p, if row.relu { $greater(sum, zero) } else { sum });
                    }
                }
            }
        }
    };
}

/// Without special instructions: the compiler makes of loops over arrays what the architecture has.
mod portable {

    use std::array::from_fn;

    use super::{CHUNK, LANES, Lane, Row};

    type Vector = [f32; 4];

    /// Whether there is an instruction for a fused multiply-add; without one it would be a function call.
    const FUSED: bool = cfg!(any(target_arch = "aarch64", target_feature = "fma"));

    fn load(lane: &Lane, part: usize) -> Vector {
        from_fn(|i| lane[4 * part + i])
    }

    fn store(lane: &mut Lane, part: usize, vector: Vector) {
        lane[4 * part..4 * part + 4].copy_from_slice(&vector);
    }

    fn fused(x: Vector, w: Vector, sum: Vector) -> Vector {
        from_fn(|i| if FUSED { x[i].mul_add(w[i], sum[i]) } else { x[i] * w[i] + sum[i] })
    }

    fn splat(x: f32) -> Vector {
        [x; 4]
    }

    fn add(a: Vector, b: Vector) -> Vector {
        from_fn(|i| a[i] + b[i])
    }

    fn greater(a: Vector, b: Vector) -> Vector {
        from_fn(|i| a[i].max(b[i]))
    }

    tile!(Vector, 4, load, store, splat, fused, add, greater);

    pub(super) fn run(mut row: Row<'_>) {
        tiles!(row, 2, 1);
    }
}

/// AVX2 and fused multiply-add: sixteen registers of eight numbers, ten of them sums.
#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::{
        __m256, _mm256_add_ps, _mm256_fmadd_ps, _mm256_loadu_ps, _mm256_max_ps, _mm256_set1_ps,
        _mm256_storeu_ps,
    };

    use super::{CHUNK, LANES, Lane, Row};

    #[inline]
    #[target_feature(enable = "avx2,fma")]
    fn load(lane: &Lane, part: usize) -> __m256 {
        let (parts, _) = lane.as_chunks::<8>();
        // SAFETY: the pointer is of an array of eight numbers; the load needs no alignment.
        #[allow(unsafe_code)]
        unsafe {
            _mm256_loadu_ps(parts[part].as_ptr())
        }
    }

    #[inline]
    #[target_feature(enable = "avx2,fma")]
    fn store(lane: &mut Lane, part: usize, vector: __m256) {
        let (parts, _) = lane.as_chunks_mut::<8>();
        // SAFETY: the pointer is of an array of eight numbers that nobody else sees; the store needs no alignment.
        #[allow(unsafe_code)]
        unsafe {
            _mm256_storeu_ps(parts[part].as_mut_ptr(), vector);
        }
    }

    tile!(
        #[target_feature(enable = "avx2,fma")]
        __m256,
        8,
        load,
        store,
        _mm256_set1_ps,
        _mm256_fmadd_ps,
        _mm256_add_ps,
        _mm256_max_ps
    );

    #[target_feature(enable = "avx2,fma")]
    pub(super) fn run(mut row: Row<'_>) {
        tiles!(row, 5, 1);
    }
}

/// AVX-512: thirty-two registers of sixteen numbers, twenty of them sums.
#[cfg(target_arch = "x86_64")]
mod avx512 {
    use std::arch::x86_64::{
        __m512, _mm512_add_ps, _mm512_fmadd_ps, _mm512_loadu_ps, _mm512_max_ps, _mm512_set1_ps,
        _mm512_storeu_ps,
    };

    use super::{CHUNK, LANES, Lane, Row};

    #[inline]
    #[target_feature(enable = "avx512f,fma")]
    fn load(lane: &Lane, _: usize) -> __m512 {
        // SAFETY: the pointer is of an array of sixteen numbers; the load needs no alignment.
        #[allow(unsafe_code)]
        unsafe {
            _mm512_loadu_ps(lane.as_ptr())
        }
    }

    #[inline]
    #[target_feature(enable = "avx512f,fma")]
    fn store(lane: &mut Lane, _: usize, vector: __m512) {
        // SAFETY: the pointer is of an array of sixteen numbers that nobody else sees; the store needs no alignment.
        #[allow(unsafe_code)]
        unsafe {
            _mm512_storeu_ps(lane.as_mut_ptr(), vector);
        }
    }

    tile!(
        #[target_feature(enable = "avx512f,fma")]
        __m512,
        16,
        load,
        store,
        _mm512_set1_ps,
        _mm512_fmadd_ps,
        _mm512_add_ps,
        _mm512_max_ps
    );

    #[target_feature(enable = "avx512f,fma")]
    pub(super) fn run(mut row: Row<'_>) {
        match (row.bias.len(), row.voxels) {
            (1, 20..) => tiles!(row, 20, 1),
            (1, 10..) => tiles!(row, 10, 1),
            (1, _) => tiles!(row, 5, 1),
            (_, 10..) => tiles!(row, 10, 2),
            _ => tiles!(row, 5, 2),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::{CHUNK, Isa, LANES, Row};

    proptest! {
        /// Every instruction set computes what the definition says, for rows of every length and both group sizes.
        #[test]
        fn kernels_compute_the_sum_of_products(
            voxels in 1usize..45, taps in 1usize..10, chunks in 1usize..5, step in 1usize..3, blocks in 1usize..3,
            relu in any::<bool>(), with_residual in any::<bool>(), seed in any::<u32>(),
        ) {
            let mut state = seed;
            let mut number = || {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 8) as f32 / (1 << 24) as f32 - 0.5
            };
            let inputs = chunks * CHUNK;
            let (step, stride) = (step * CHUNK, blocks * LANES + 16);
            let input: Vec<f32> = (0..taps * 64 + voxels * step + inputs).map(|_| number()).collect();
            let rows: Vec<usize> = (0..taps).map(|t| t * 64).collect();
            let mut lane = |_| std::array::from_fn(|_| number());
            let weights: Vec<[f32; LANES]> = (0..taps * inputs * blocks).map(&mut lane).collect();
            let bias: Vec<[f32; LANES]> = (0..blocks).map(&mut lane).collect();
            let residual: Vec<f32> = (0..8 + voxels * stride).map(|_| number()).collect();
            for isa in Isa::all() {
                let blocks = if isa.two_blocks() { blocks } else { 1 };
                let weights: Vec<_> = weights.chunks_exact(bias.len()).flat_map(|w| &w[..blocks]).copied().collect();
                let mut output = vec![f32::NAN; voxels * stride];
                Row {
                    input: &input, rows: &rows, inputs, step, weights: &weights, bias: &bias[..blocks],
                    residual: with_residual.then_some((&residual[..], 8, stride)), relu,
                    output: &mut output, output_step: stride, voxels,
                }
                .compute(isa);
                for v in 0..voxels {
                    for channel in 0..stride {
                        let found = output[v * stride + channel];
                        let (block, l) = (channel / LANES, channel % LANES);
                        if block >= blocks {
                            prop_assert!(found.is_nan(), "{isa:?}: channel {channel} was written");
                            continue;
                        }
                        let mut sum = f64::from(bias[block][l]);
                        for t in 0..taps {
                            for k in 0..inputs {
                                let w = weights[(t * inputs + k) * blocks + block][l];
                                sum += f64::from(w) * f64::from(input[rows[t] + v * step + k]);
                            }
                        }
                        if with_residual {
                            sum += f64::from(residual[8 + v * stride + channel]);
                        }
                        let expected = if relu { sum.max(0.0) } else { sum };
                        prop_assert!((f64::from(found) - expected).abs() < 1e-4, "{isa:?}: {found} for {expected}");
                    }
                }
            }
        }
    }
}
