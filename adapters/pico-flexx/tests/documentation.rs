//! The settings that the documentation shows are settings that are taken.
#![allow(clippy::unwrap_used)]

use graspd_adapters_core::testing::camera_examples;
use graspd_adapters_pico_flexx::FlexxSettings;

#[test]
fn worked_examples_are_taken() {
    let page = include_str!("../../../docs/devices/pico_flexx.md");
    let found = camera_examples(page, "pico-flexx", |table, address| {
        let settings: FlexxSettings =
            table.map_or_else(|| Ok(FlexxSettings::default()), toml::Value::try_into).unwrap();
        settings.with_address(address).check().unwrap();
    });
    assert!(found >= 2, "{found}");
}
