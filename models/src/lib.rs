//! The contact networks that graspd ships, embedded in the program: no download, no file to lose.
//!
//! Each stands in `weights/` as the ONNX file that `graspd_train.export` wrote, with its model card beside it: data,
//! commands, seeds, commit and metrics, from which anyone can make it again. What a network is worth is measured by
//! `graspd eval`; figures are in `docs/evaluation-results.md` of the repository.

use graspd_inference::{ModelError, Network};
use graspd_planner::estimator::Learned;

/// Trained on truncated signed distances, answers with quaternions (Supplementary Note 2).
pub const TSDF_QUATERNION: &[u8] = include_bytes!("../weights/tsdf-quaternion.onnx");

/// The estimator that graspd ships.
///
/// # Errors
/// [`ModelError`] if the program's own copy was damaged.
pub fn learned() -> Result<Learned, ModelError> {
    Ok(Learned::new(Network::from_bytes(TSDF_QUATERNION)?, Vec::new()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use graspd_inference::{OrientationKind, VolumeInput};

    #[test]
    fn every_network_is_what_its_name_and_its_card_say() {
        let network = Network::from_bytes(TSDF_QUATERNION).unwrap();
        let info = network.info();
        assert_eq!((info.volume, info.orientation), (VolumeInput::Tsdf, OrientationKind::Quaternion));
        assert_eq!(info.side, 80);
        let card: serde_json::Value =
            serde_json::from_str(include_str!("../weights/tsdf-quaternion.json")).unwrap();
        let text = |key: &str| card[key].as_str().unwrap_or_default().to_owned();
        assert_eq!((text("volume"), text("orientation")), ("tsdf".into(), "quaternion".into()));
        // The card is of this file: its checksum stands in the file's own metadata.
        let crc = text("crc32");
        assert!(crc.len() == 8 && TSDF_QUATERNION.windows(8).any(|w| w == crc.as_bytes()), "{crc}");
        for (metric, least) in [("e_pc", 0.9), ("e_pe", 0.9), ("e_angle", 0.7)] {
            assert!(card["validation"][metric].as_f64().is_some_and(|v| v >= least), "{metric}");
        }
        assert!(TSDF_QUATERNION.len() <= 8 << 20);
    }
}
