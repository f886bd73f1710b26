//! Reading `cell.toml`, and what the environment says instead.

use super::CellConfig;

/// Why a configuration is not accepted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ConfigError {
    /// The text is not TOML, or has a key or type that is not expected; the message has line, key and expectation.
    #[error("{0}")]
    Toml(String),
    /// A value is outside what it must be.
    #[error("{field}: found {found}, expected {expected}")]
    Value {
        /// The field, or the variable of the environment.
        field: String,
        /// Found value.
        found: String,
        /// What is expected.
        expected: String,
    },
}

/// Variables of the environment that stand above the file, and the fields that they set.
pub const ENVIRONMENT: [(&str, &str); 7] = [
    ("GRASPD_CELL_ENDPOINT", "planner.endpoint (and planner.embedded = false)"),
    ("GRASPD_CELL_HAND", "hand.id"),
    ("GRASPD_CELL_TRIALS", "run.trials"),
    ("GRASPD_CELL_TIME_LIMIT_S", "run.time_limit_s"),
    ("GRASPD_CELL_SEED", "run.seed"),
    ("GRASPD_CELL_RECORDING", "recording.folder"),
    ("GRASPD_CELL_ESTIMATOR", "planner.estimator"),
];

impl CellConfig {
    /// Reads a file's text. Not yet checked: see [`CellConfig::check`].
    ///
    /// # Errors
    /// [`ConfigError::Toml`].
    pub fn parse(text: &str) -> Result<Self, ConfigError> {
        toml::from_str(text).map_err(|e| ConfigError::Toml(e.to_string().trim_end().to_owned()))
    }

    /// Sets what the environment says; empty variables say nothing.
    ///
    /// # Errors
    /// [`ConfigError::Value`] for a variable that is not of its type.
    pub fn apply_environment(
        &mut self,
        variable: impl Fn(&str) -> Option<String>,
    ) -> Result<(), ConfigError> {
        let text = |name| variable(name).filter(|value| !value.is_empty());
        if let Some(endpoint) = text("GRASPD_CELL_ENDPOINT") {
            self.planner.endpoint = endpoint;
            self.planner.embedded = false;
        }
        if let Some(hand) = text("GRASPD_CELL_HAND") {
            self.hand.id = hand;
        }
        if let Some(estimator) = text("GRASPD_CELL_ESTIMATOR") {
            self.planner.estimator = estimator;
        }
        if let Some(folder) = text("GRASPD_CELL_RECORDING") {
            self.recording.folder = Some(folder.into());
        }
        number("GRASPD_CELL_TRIALS", text("GRASPD_CELL_TRIALS"), &mut self.run.trials, "a whole number")?;
        number("GRASPD_CELL_SEED", text("GRASPD_CELL_SEED"), &mut self.run.seed, "a whole number")?;
        let limit = &mut self.run.time_limit_s;
        number("GRASPD_CELL_TIME_LIMIT_S", text("GRASPD_CELL_TIME_LIMIT_S"), limit, "a number of seconds")
    }
}

fn number<T: std::str::FromStr>(
    name: &str,
    value: Option<String>,
    field: &mut T,
    expected: &str,
) -> Result<(), ConfigError> {
    let Some(text) = value else { return Ok(()) };
    *field = text.parse().map_err(|_| ConfigError::Value {
        field: name.to_owned(),
        found: text.clone(),
        expected: expected.to_owned(),
    })?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn error(text: &str) -> String {
        let config = CellConfig::parse(text).and_then(|c| c.check().map(|()| c));
        config.unwrap_err().to_string()
    }

    #[test]
    fn the_example_is_valid_and_an_empty_file_too() {
        let example = CellConfig::parse(include_str!("../../examples/clear_tray.toml")).unwrap();
        example.check().unwrap();
        CellConfig::parse("").unwrap().check().unwrap();
    }

    #[test]
    fn the_example_shows_the_defaults() {
        let mut example = CellConfig::parse(include_str!("../../examples/clear_tray.toml")).unwrap();
        assert!(example.simulation.is_some());
        example.simulation = None;
        assert_eq!(example, CellConfig::default());
    }

    #[test]
    fn a_written_configuration_reads_back() {
        let config = CellConfig::default();
        assert_eq!(CellConfig::parse(&toml::to_string(&config).unwrap()).unwrap(), config);
    }

    #[test]
    fn errors_name_the_field_what_was_found_and_what_was_expected() {
        for (text, expected) in [
            ("[hand]\nforce = 0", "hand.force: found 0, expected more than 0, at most 1"),
            ("[run]\ntrials = 0", "run.trials: found 0, expected 1 to 1000000"),
            ("[planner]\nscheme = [20, 40]", "planner.scheme[1]: found 40, expected 0 to 20"),
            (
                "[tray]\nwidth_m = 0.5",
                "tray.width_m: found 0.5, expected more than 0.02, at most tray.volume_m",
            ),
            ("[tray]\nwall_height_m = -0.01", "tray.wall_height_m: found -0.01, expected 0 (no walls) to"),
            ("[tray]\nwall_height_m = nan", "tray.wall_height_m: found NaN"),
            ("[tray]\nwall_m = 0", "tray.wall_m: found 0, expected 0.0005 to 0.05"),
            ("[recovery]\nempty_frames = 1", "recovery.empty_frames: found 1, expected 2 to 1000"),
            ("[timeouts]\nmove_s = nan", "timeouts.move_s: found NaN, expected a number above 0"),
            (
                "[drop]\nposition_m = [0.1, 0, 0.3]",
                "drop.position_m: found [0.1, 0.0, 0.3], expected a place at least 0.1 m beside",
            ),
            // The hand would be inside the volume, and the bin under it over the tray.
            ("[drop]\nposition_m = [0.22, 0, 0.25]", "drop.position_m: found [0.22, 0.0, 0.25], expected a"),
            ("[drop]\nposition_m = [0, -0.22, 9]", "drop.position_m: found [0.0, -0.22, 9.0], expected a"),
            ("[tray]\nyaw_rad = 0.785\n[drop]\nposition_m = [0.35, 0, 0.25]", "drop.position_m: found [0.35"),
            (
                "[motion]\nwait_position_m = [0.0, 0.25, 0.3]",
                "motion.wait_position_m: found [0.0, 0.25, 0.3], expected a place above the tray's volume, or at least",
            ),
            ("[hand]\nid = \"\"", "hand.id: found \"\", expected the id of a hand"),
            ("[hand]\nid = 3", "expected a string"),
            (
                "[arm.settings]\nreach_m = 1.0",
                "arm.settings.reach_m: found 1.0, expected a table for each kind of arm",
            ),
            ("[tary]", "unknown field `tary`"),
            ("[tray]\nwidht_m = 0.3", "unknown field `widht_m`, expected one of"),
            ("[planner]\nreaching = \"up\"", "unknown variant `up`, expected one of `top_down`"),
        ] {
            let message = error(text);
            assert!(message.contains(expected), "{message}\nshould contain\n{expected}");
        }
    }

    #[test]
    fn the_hand_waits_beside_the_volume_or_above_it() {
        for text in [
            "[drop]\nposition_m = [0.31, 0, 0.25]",
            "[drop]\nposition_m = [0.28, -0.28, 0.25]",
            "[tray]\nposition_m = [0.4, 0, 0]\n[drop]\nposition_m = [0, 0, 0.25]",
            "[motion]\nwait_position_m = [0.0, 0.0, 0.6]",
            "[motion]\nwait_position_m = [0.0, 0.35, 0.2]",
        ] {
            CellConfig::parse(text).unwrap().check().unwrap_or_else(|e| panic!("{text}: {e}"));
        }
    }

    #[test]
    fn the_environment_stands_above_the_file() {
        let mut config = CellConfig::default();
        let set = |name: &str| match name {
            "GRASPD_CELL_ENDPOINT" => Some("http://10.0.0.1:1".to_owned()),
            "GRASPD_CELL_HAND" => Some("barrett".to_owned()),
            "GRASPD_CELL_TRIALS" => Some("7".to_owned()),
            "GRASPD_CELL_SEED" => Some(String::new()),
            _ => None,
        };
        config.apply_environment(set).unwrap();
        assert_eq!((config.planner.embedded, config.run.trials, config.run.seed), (false, 7, 0));
        assert_eq!(
            (config.hand.id.as_str(), config.planner.endpoint.as_str()),
            ("barrett", "http://10.0.0.1:1")
        );
        let wrong = |name: &str| (name == "GRASPD_CELL_TRIALS").then(|| "many".to_owned());
        let message = config.apply_environment(wrong).unwrap_err().to_string();
        assert_eq!(message, "GRASPD_CELL_TRIALS: found many, expected a whole number");
    }

    proptest! {
        #[test]
        fn no_text_panics(text in "[ -~\n]{0,200}") {
            if let Ok(config) = CellConfig::parse(&text) {
                let _ = config.check();
            }
        }
    }
}
