//! What docs/inference.md shows is a program that runs.

use graspd_inference::Network;

#[test]
fn the_documented_program_runs() -> Result<(), Box<dyn std::error::Error>> {
    let bytes: Vec<u8> = include_bytes!("models/ours-tsdf-quaternion.onnx").to_vec();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build()?;
    let (volume, voxel) = (vec![0.0; 16 * 16 * 16], 7);
    #[rustfmt::skip]
    let (contact, centroid) = {
        let network = Network::from_bytes(&bytes)?;       // ModelError says what was found and what was expected
        let output = pool.install(|| network.run(&volume))?;
        let contact = (output.certainty[voxel], output.orientation.inward(voxel));    // P_c, and into the object
        let centroid = output.centroid[voxel];                                        // P_e
        (contact, centroid)
    };
    assert!((0.0..=1.0).contains(&contact.0) && (0.0..=1.0).contains(&centroid), "{contact:?} {centroid}");
    let length: f32 = contact.1.iter().map(|x| x * x).sum();
    assert!(length == 0.0 || (length - 1.0).abs() < 1e-3, "{contact:?}");
    Ok(())
}
