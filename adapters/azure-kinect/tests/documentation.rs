//! The settings that the documentation shows are settings that are taken.
#![allow(clippy::unwrap_used)]

use graspd_adapters_azure_kinect::KinectSettings;

const PAGE: &str = include_str!("../../../docs/devices/azure_kinect.md");

#[test]
fn worked_examples_are_taken() {
    let mut found = 0;
    for block in PAGE.split("```toml\n").skip(1) {
        let (text, _) = block.split_once("```").unwrap();
        let file: toml::Table = toml::from_str(text).unwrap();
        let camera = file["camera"].as_table().unwrap();
        assert_eq!(camera["kind"].as_str(), Some("azure-kinect"));
        let table = camera.get("settings").and_then(|s| s.get("azure-kinect")).cloned();
        let settings: KinectSettings =
            table.map_or_else(|| Ok(KinectSettings::default()), toml::Value::try_into).unwrap();
        let address = camera.get("address").and_then(toml::Value::as_str).unwrap_or_default();
        settings.with_address(address).check().unwrap();
        found += 1;
    }
    assert!(found >= 2, "{found}");
}
