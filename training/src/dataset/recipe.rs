//! Every number of the generation: what scenes, views and grasps are drawn from.

use serde::{Deserialize, Serialize};

use super::DatasetError;
use crate::evaluate::ap::MAX_WIDTH_M;

/// What scenes, views and grasps are drawn from; ranges are `[least, most]`. Kept in every shard's header.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Recipe {
    /// Objects of a scene.
    pub objects: [usize; 2],
    /// Share of the scenes that lie in a tray, the others on a bare table.
    pub tray_share: f64,
    /// Share of the scenes that stand packed, the others are poured.
    pub packed_share: f64,
    /// Diffuse reflectivity of table and tray.
    pub table_albedo: [f64; 2],
    /// Tilt of the view from straight down, degrees.
    pub tilt_deg: [f64; 2],
    /// Distance of the camera from what it looks at, metres.
    pub distance_m: [f64; 2],
    /// What a camera looks at lies at most this far from the scene's middle, along each axis, metres.
    pub aim_m: f64,
    /// Standard deviation of a camera's roll about its axis, degrees.
    pub roll_deg: f64,
    /// Share of the views whose camera is rolled by any angle.
    pub any_roll_share: f64,
    /// Share of the views whose volume the planner places on the table that it finds; in the others it stands where a
    /// calibrated caller puts it, turned by any yaw.
    pub auto_share: f64,
    /// Largest offset of such a caller's volume from the scene's middle, metres.
    pub shift_m: f64,
    /// Largest offset of such a caller's table height from 0.10 m, metres.
    pub lift_m: f64,
    /// Places on an object's surface where a finger is tried, per square centimetre.
    pub places_per_cm2: f64,
    /// Such places on one object, least and most.
    pub places: [usize; 2],
    /// Standard deviation of the closing direction about the best one, degrees.
    pub closing_deg: f64,
    /// Largest friction coefficient at which a grasp must be in force closure; scores are 1.1 less the coefficient.
    pub max_friction: f64,
    /// Approach directions tried for each pair of contacts, evenly around it.
    pub approaches: usize,
    /// An approach may come from below by at most this angle, degrees.
    pub from_below_deg: f64,
    /// Distance of each finger from the surface before the jaws close, metres.
    pub clearance_m: [f64; 2],
}

impl Default for Recipe {
    fn default() -> Self {
        Self {
            objects: [1, 14],
            tray_share: 0.5,
            packed_share: 0.4,
            table_albedo: [0.3, 0.8],
            tilt_deg: [0.0, 65.0],
            distance_m: [0.45, 0.95],
            aim_m: 0.05,
            roll_deg: 8.0,
            any_roll_share: 0.25,
            auto_share: 0.5,
            shift_m: 0.03,
            lift_m: 0.01,
            places_per_cm2: 10.0,
            places: [600, 4000],
            closing_deg: 3.0,
            max_friction: 0.4,
            approaches: 8,
            from_below_deg: 10.0,
            clearance_m: [0.001, 0.006],
        }
    }
}

impl Recipe {
    /// The defaults for a sensor by name: a palm camera looks from nearer.
    pub fn for_sensor(name: &str) -> Self {
        let distance_m = if name == "pico-flexx" { [0.25, 0.7] } else { [0.45, 0.95] };
        Self { distance_m, ..Self::default() }
    }

    /// A recipe from JSON with any of its fields; those left out are as [`Recipe::for_sensor`] has them.
    ///
    /// # Errors
    /// For text that is no JSON object, unknown fields and values of the wrong type.
    pub fn from_json(text: &str, sensor: &str) -> Result<Self, serde_json::Error> {
        let given: serde_json::Map<String, serde_json::Value> = serde_json::from_str(text)?;
        let mut all = serde_json::to_value(Self::for_sensor(sensor))?;
        if let Some(fields) = all.as_object_mut() {
            fields.extend(given);
        }
        serde_json::from_value(all)
    }

    /// Checks every number.
    ///
    /// # Errors
    /// [`DatasetError::Setting`] for the first that is out of its range.
    pub fn check(&self) -> Result<(), DatasetError> {
        let within = |field, [low, high]: [f64; 2], least: f64, most: f64| {
            // A NaN is within no bounds.
            if least <= low && low <= high && high <= most {
                return Ok(());
            }
            Err(DatasetError::Setting {
                field,
                found: if low == high { low.to_string() } else { format!("{low} to {high}") },
                expected: format!("{least} to {most}, the smaller number first"),
            })
        };
        let one = |value: f64| [value; 2];
        let count = |[low, high]: [usize; 2]| [low as f64, high as f64];
        within("recipe.objects", count(self.objects), 1.0, 40.0)?;
        for (field, share) in [
            ("recipe.tray_share", self.tray_share),
            ("recipe.packed_share", self.packed_share),
            ("recipe.any_roll_share", self.any_roll_share),
            ("recipe.auto_share", self.auto_share),
        ] {
            within(field, one(share), 0.0, 1.0)?;
        }
        within("recipe.table_albedo", self.table_albedo, 0.0, 1.0)?;
        within("recipe.tilt_deg", self.tilt_deg, 0.0, 85.0)?;
        within("recipe.distance_m", self.distance_m, 0.2, 3.0)?;
        within("recipe.aim_m", one(self.aim_m), 0.0, 0.3)?;
        within("recipe.roll_deg", one(self.roll_deg), 0.0, 180.0)?;
        within("recipe.shift_m", one(self.shift_m), 0.0, 0.2)?;
        within("recipe.lift_m", one(self.lift_m), 0.0, 0.09)?;
        within("recipe.places_per_cm2", one(self.places_per_cm2), 0.01, 100.0)?;
        within("recipe.places", count(self.places), 1.0, 100_000.0)?;
        within("recipe.closing_deg", one(self.closing_deg), 0.0, 45.0)?;
        within("recipe.max_friction", one(self.max_friction), 0.1, 1.0)?;
        within("recipe.approaches", count([self.approaches; 2]), 1.0, 64.0)?;
        within("recipe.from_below_deg", one(self.from_below_deg), 0.0, 90.0)?;
        within("recipe.clearance_m", self.clearance_m, 0.0, 0.25 * MAX_WIDTH_M)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_accepted_and_what_is_out_of_range_is_named() {
        for name in graspd_sim::sensor::Sensor::NAMES {
            Recipe::for_sensor(name).check().unwrap();
        }
        let wrong = |recipe: Recipe| recipe.check().unwrap_err().to_string();
        let d = Recipe::default;
        assert!(wrong(Recipe { objects: [3, 2], ..d() }).starts_with("recipe.objects: found 3 to 2"));
        assert!(wrong(Recipe { auto_share: f64::NAN, ..d() }).starts_with("recipe.auto_share: found NaN"));
        assert!(wrong(Recipe { max_friction: 1.2, ..d() }).starts_with("recipe.max_friction: found 1.2"));
    }

    #[test]
    fn a_recipe_comes_back_from_json() {
        let recipe = Recipe { lift_m: 0.1 / 3.0, ..Recipe::default() };
        let text = serde_json::to_string(&recipe).unwrap();
        assert_eq!(serde_json::from_str::<Recipe>(&text).unwrap(), recipe);
        let partly = Recipe::from_json(r#"{"objects": [2, 3]}"#, "pico-flexx").unwrap();
        assert_eq!(partly, Recipe { objects: [2, 3], ..Recipe::for_sensor("pico-flexx") });
        assert_eq!(Recipe::from_json(&text, "pico-flexx").unwrap(), recipe);
        assert!(Recipe::from_json(r#"{"tray": 1}"#, "ideal").is_err());
        assert!(Recipe::from_json("[1]", "ideal").is_err());
    }
}
