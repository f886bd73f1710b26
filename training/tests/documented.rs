//! The header that docs/dataset.md shows is one.

use graspd_training::dataset::recipe::Recipe;
use graspd_training::dataset::shard::{FORMAT, Header};

#[test]
fn the_documented_header_is_one() -> Result<(), Box<dyn std::error::Error>> {
    let page = include_str!("../../docs/dataset.md");
    let text = page.split("```json\n").nth(1).and_then(|rest| rest.split("```").next()).ok_or("no block")?;
    let mut documented: serde_json::Value = serde_json::from_str(text)?;
    // There it is left empty, for it is long.
    documented["recipe"] = serde_json::to_value(Recipe::default())?;
    let read: Header = serde_json::from_value(documented.clone())?;
    assert_eq!(serde_json::to_value(&read)?, documented);
    assert_eq!((read.format.as_str(), read.shard), (FORMAT, [3, 16]));
    Ok(())
}
