//! The settings that the documentation shows are settings that are taken.
#![allow(clippy::unwrap_used)]

use graspd_adapters_azure_kinect::KinectSettings;
use graspd_adapters_core::testing::camera_examples;

#[test]
fn worked_examples_are_taken() {
    let page = include_str!("../../../docs/devices/azure_kinect.md");
    let found = camera_examples(page, "azure-kinect", |table, address| {
        let settings: KinectSettings =
            table.map_or_else(|| Ok(KinectSettings::default()), toml::Value::try_into).unwrap();
        settings.with_address(address).check().unwrap();
    });
    assert!(found >= 2, "{found}");
}
