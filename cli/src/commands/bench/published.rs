//! Times to compare with: what the paper published, and what this project set itself.

/// Optimization time of the paper's implementation, milliseconds: Supplementary Table 2, scheme [200, 40],
/// batch 48, NVIDIA RTX 3060 Ti.
pub(super) fn time_ms(name: &str) -> Option<f64> {
    let seconds = match name {
        "optimize.robotiq-2f85" => 1.51,
        "optimize.finray-2f" => 1.69,
        "optimize.finray-4f" => 2.07,
        "optimize.model-o" => 2.22,
        "optimize.robotiq-3f" => 3.68,
        "optimize.brunel" => 3.45,
        "optimize.leap" => 4.33,
        // Supplementary Table 1, voxel volume, T_fc 0.7: time for every 100 iterations of a batch of 500.
        "optimize.antipodal.500x100" => 1.71,
        _ => return None,
    };
    Some(seconds * 1e3)
}

/// Optimization time of the reference implementation on a CPU, milliseconds: two threads of a quiet two-core
/// machine without a GPU, scheme [200, 40], batch 48, median of two to three runs after the first. The
/// antipodal batch with the reference's random tenth of the focal contacts (54 s with all of them).
pub(super) fn reference_ms(name: &str) -> Option<f64> {
    let seconds = match name {
        "optimize.robotiq-2f85" => 17.1,
        "optimize.finray-2f" => 18.0,
        "optimize.finray-4f" => 19.7,
        "optimize.model-o" => 25.4,
        "optimize.barrett" => 26.7,
        "optimize.robotiq-3f" => 32.2,
        "optimize.leap" => 31.8,
        "optimize.brunel" => 37.5,
        "optimize.antipodal.500x100" => 5.6,
        _ => return None,
    };
    Some(seconds * 1e3)
}

/// This project's own aim on two cores, milliseconds.
pub(super) fn target_ms(name: &str) -> Option<f64> {
    Some(match name {
        "volume.tsdf" | "volume.occupancy" => 6.0,
        "refine" | "optimize.robotiq-2f85" => 15.0,
        "optimize.robotiq-3f" => 45.0,
        "optimize.leap" => 60.0,
        "optimize.antipodal.500x100" => 80.0,
        _ => return None,
    })
}
