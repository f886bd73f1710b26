//! Answers equal PyTorch's, whatever the number of threads, and files that are not whole, or not ours, are refused.

use graspd_inference::{ModelError, Network, OrientationKind, Orientations, RunError, VolumeInput};
use proptest::prelude::*;

const MODELS: [(&str, &[u8], &[u8]); 3] = [
    (
        "ours-tsdf-quaternion",
        include_bytes!("models/ours-tsdf-quaternion.onnx"),
        include_bytes!("models/ours-tsdf-quaternion.f32"),
    ),
    (
        "ours-occupancy-r6d",
        include_bytes!("models/ours-occupancy-r6d.onnx"),
        include_bytes!("models/ours-occupancy-r6d.f32"),
    ),
    (
        "reference-tsdf-quaternion",
        include_bytes!("models/reference-tsdf-quaternion.onnx"),
        include_bytes!("models/reference-tsdf-quaternion.f32"),
    ),
];

/// The volume that `graspd_train.golden` makes.
fn volume() -> Vec<f32> {
    (0..16u64.pow(3)).map(|i| ((i * 2_654_435_761 % (1 << 32)) >> 8) as f32 / (1 << 24) as f32).collect()
}

#[test]
fn answers_equal_those_of_pytorch() {
    for (name, model, golden) in MODELS {
        let network = Network::from_bytes(model).expect(name);
        let answer = network.run(&volume()).expect("a volume of the right size");
        let numbers = match &answer.orientation {
            Orientations::Quaternion(_) => 4,
            Orientations::R6d(_) => 6,
        };
        let golden: Vec<f32> = golden.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        assert_eq!(golden.len(), 512 * (2 + numbers));
        for (k, expected) in golden.chunks_exact(2 + numbers).enumerate() {
            let voxel = 8 * k;
            let orientation: &[f32] = match &answer.orientation {
                Orientations::Quaternion(all) => &all[voxel],
                Orientations::R6d(all) => &all[voxel],
            };
            let found = [&[answer.certainty[voxel], answer.centroid[voxel]], orientation].concat();
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-4, "{name}, voxel {voxel}: {found} for {expected}");
            }
        }
    }
}

#[test]
fn files_say_what_they_want_and_give() {
    let infos = MODELS.map(|(name, model, _)| Network::from_bytes(model).expect(name).info().clone());
    assert_eq!((infos[0].volume, infos[0].orientation), (VolumeInput::Tsdf, OrientationKind::Quaternion));
    assert_eq!((infos[1].volume, infos[1].orientation), (VolumeInput::Occupancy, OrientationKind::R6d));
    assert_eq!(infos[2].side, 16);
}

#[test]
fn the_number_of_threads_and_former_runs_change_nothing() {
    let network = Network::from_bytes(MODELS[0].1).expect("a whole model");
    let on = |threads: usize, volume: &[f32]| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| network.run(volume)).expect("a volume of the right size")
    };
    let once = on(1, &volume());
    on(2, &vec![0.7; 4096]);
    assert_eq!(once, on(3, &volume()));
}

#[test]
fn wrong_volumes_and_stops_are_told() {
    let network = Network::from_bytes(MODELS[0].1).expect("a whole model");
    assert_eq!(network.run(&[0.0; 80]), Err(RunError::Size { found: 80, expected: 4096, side: 16 }));
    let left = std::cell::Cell::new(5);
    let go_on = || {
        left.set(left.get() - 1);
        left.get() > 0
    };
    assert_eq!(network.run_while(&volume(), &go_on), Err(RunError::Stopped));
    assert!(network.run(&volume()).is_ok());
}

/// The model with one entry of its metadata changed to a value of the same length, and the checksum made right.
fn with(model: &[u8], from: &str, to: &str) -> Vec<u8> {
    assert_eq!(from.len(), to.len());
    let mut bytes = model.to_vec();
    let at = bytes.windows(from.len()).rposition(|w| w == from.as_bytes()).expect("the text is in the file");
    bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
    let key = b"graspd.crc32\x12\x08";
    let at = bytes.windows(key.len()).rposition(|w| w == key).expect("a checksum") + key.len();
    bytes[at..at + 8].copy_from_slice(b"00000000");
    let crc = crc32fast::hash(&bytes);
    bytes[at..at + 8].copy_from_slice(format!("{crc:08x}").as_bytes());
    bytes
}

#[test]
fn files_that_are_not_ours_are_refused_with_what_was_found() {
    let model = MODELS[0].1;
    let told = |bytes: &[u8]| Network::from_bytes(bytes).expect_err("a refusal").to_string();
    assert_eq!(Network::from_bytes(b"").expect_err("a refusal"), ModelError::Foreign { key: "graspd.crc32" });
    assert!(told(b"PK\x03\x04 not a model").starts_with("model: found "));
    assert!(told(&model[..model.len() / 2]).contains("expected an ONNX file"));
    assert!(matches!(
        Network::from_bytes(&model[..model.len() - 1]),
        Err(ModelError::NotOnnx { .. } | ModelError::Foreign { .. } | ModelError::Damaged { .. })
    ));
    let mut damaged = model.to_vec();
    damaged[model.len() / 2] ^= 1;
    assert!(told(&damaged).contains("the file is damaged"), "{}", told(&damaged));
    assert_eq!(
        told(&with(model, "tsdf", "tsdx")),
        "model.graspd.volume: found `tsdx`, expected `tsdf` or `occupancy`"
    );
    assert!(told(&with(model, "Sigmoid", "Sigmoi2")).contains("found operator `Sigmoi2`, expected Conv"));
    assert!(told(&with(model, "centroid_logit", "centroid_l0git")).contains("found input `centroid_l0git`"));
    assert!(Network::from_bytes(&with(model, "tsdf", "tsdf")).is_ok());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    #[test]
    fn no_bytes_make_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        prop_assert!(Network::from_bytes(&bytes).is_err());
    }

    #[test]
    fn no_flipped_bit_goes_unnoticed(which in 0usize..3, at in any::<proptest::sample::Index>(), bit in 0u8..8) {
        let mut bytes = MODELS[which].1.to_vec();
        let at = at.index(bytes.len());
        bytes[at] ^= 1 << bit;
        prop_assert!(Network::from_bytes(&bytes).is_err(), "bit {bit} of byte {at}");
    }

    #[test]
    fn no_cut_off_file_is_accepted(which in 0usize..3, at in any::<proptest::sample::Index>()) {
        let bytes = MODELS[which].1;
        prop_assert!(Network::from_bytes(&bytes[..at.index(bytes.len())]).is_err());
    }

    /// Damage with a checksum that was made right: refused or run, but no panic.
    #[test]
    fn well_signed_nonsense_makes_no_panic(
        which in 0usize..3, damage in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..4)
    ) {
        let mut bytes = MODELS[which].1.to_vec();
        let end = bytes.len();
        for (at, value) in damage {
            // Where nodes stand, at the front, and names of weights and metadata, at the end.
            let at = at.index(6000);
            let at = if at < 4000 { at } else { end - 1 - (at - 4000) };
            bytes[at] = value;
        }
        let key = b"graspd.crc32\x12\x08";
        if let Some(at) = bytes.windows(key.len()).rposition(|w| w == key) {
            let at = at + key.len();
            bytes[at..at + 8].copy_from_slice(b"00000000");
            let crc = crc32fast::hash(&bytes);
            bytes[at..at + 8].copy_from_slice(format!("{crc:08x}").as_bytes());
            if let Ok(network) = Network::from_bytes(&bytes) && network.info().side <= 32 {
                let _ = network.run(&vec![0.5; network.info().side.pow(3)]);
            }
        }
    }
}
