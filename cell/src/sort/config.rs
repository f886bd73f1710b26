//! `sort.toml`: a cell with several arms. What all share stands as in `cell.toml`; arms, bins and rules are lists.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use crate::config::{
    ArmConfig, CameraConfig, CellConfig, ConfigError, DropConfig, HandConfig, MotionConfig, PlannerConfig,
    RecordingConfig, RecoveryConfig, RunConfig, TimeoutConfig, TrayConfig,
};

/// The whole file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SortConfig {
    /// How arms share objects and space.
    #[serde(default)]
    pub sort: SharingConfig,
    /// The arms with their hands.
    pub arms: Vec<ArmStation>,
    /// Where objects go.
    pub bins: Vec<BinConfig>,
    /// Which object goes where; the first rule that an object fits is its own.
    pub rules: Vec<Rule>,
    /// Who plans.
    #[serde(default)]
    pub planner: PlannerConfig,
    /// The depth camera.
    #[serde(default)]
    pub camera: CameraConfig,
    /// Where objects are picked.
    #[serde(default)]
    pub tray: TrayConfig,
    /// How arms move; `wait_position_m` is each arm's own.
    #[serde(default)]
    pub motion: MotionConfig,
    /// How long each call may take.
    #[serde(default)]
    pub timeouts: TimeoutConfig,
    /// How much is tried before giving up; counted for each arm.
    #[serde(default)]
    pub recovery: RecoveryConfig,
    /// When the run ends; trials are counted for each arm.
    #[serde(default)]
    pub run: RunConfig,
    /// What is kept of it.
    #[serde(default)]
    pub recording: RecordingConfig,
    /// The simulated world; read by who wires it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub simulation: Option<toml::Table>,
}

/// `[sort]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SharingConfig {
    /// Room between the corridors of arms, metres.
    pub clearance_m: f64,
    /// An arm that shows no life for so long while it has a lease is asked where it is, seconds.
    pub lease_s: f64,
    /// An arm that was lost is tried again after so long, seconds.
    pub come_back_s: f64,
    /// What is nearer than this to something that was picked may have moved: it waits for the next look, metres.
    pub disturbed_m: f64,
    /// Bound on the time of one assignment, seconds.
    pub assign_s: f64,
    /// Smallest height above the floor that is an object, metres.
    pub object_height_m: f64,
    /// Look also while arms are over the tray, past them; else only when none is, and for all that are free then together.
    pub look_past_arms: bool,
}

impl Default for SharingConfig {
    fn default() -> Self {
        Self {
            clearance_m: 0.03,
            lease_s: 60.0,
            come_back_s: 5.0,
            disturbed_m: 0.02,
            assign_s: 0.05,
            object_height_m: 0.012,
            look_past_arms: false,
        }
    }
}

/// `[[arms]]`: an arm, its hand, and where it waits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArmStation {
    /// Its name in tables, records and reasons.
    pub name: String,
    /// The arm.
    #[serde(default)]
    pub arm: ArmConfig,
    /// The hand.
    #[serde(default)]
    pub hand: HandConfig,
    /// Narrowest and widest object that the hand takes, metres.
    pub opening_m: [f64; 2],
    /// Where the tool point waits, the hand pointing down: out of the camera's view, in nobody's way.
    pub home_m: [f64; 3],
    /// Rotation of the hand about the vertical at home and over bins, radians.
    #[serde(default)]
    pub yaw_rad: f64,
    /// The hand and its mount are within this of the line from flange to tool point, metres; left out: the space that the
    /// hand's own description takes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hand_radius_m: Option<f64>,
    /// Names of the bins that it delivers to; nobody else does.
    pub bins: Vec<String>,
    /// Kinematics by which reach and the space that the arm takes are known, for example `ur5e`.
    pub kinematics: String,
    /// Pose of the arm's base: position, metres.
    pub base_m: [f64; 3],
    /// Pose of the arm's base: rotation about the vertical, radians.
    #[serde(default)]
    pub base_yaw_rad: f64,
}

/// `[[bins]]`: where a hand lets go.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BinConfig {
    /// Its name.
    pub name: String,
    /// Where the tool point goes to let go, metres.
    pub position_m: [f64; 3],
}

/// `[[rules]]`: which objects go into which bins.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rule {
    /// Its name.
    pub name: String,
    /// Smallest width of its objects, metres: the shorter edge that is seen from above.
    #[serde(default)]
    pub min_width_m: Option<f64>,
    /// Largest width, metres.
    #[serde(default)]
    pub max_width_m: Option<f64>,
    /// Class of its objects, where somebody tells classes; left out: any.
    #[serde(default)]
    pub class: Option<String>,
    /// Bins that its objects may go into.
    pub bins: Vec<String>,
}

impl Rule {
    /// True for an object of this width and class.
    pub fn fits(&self, width_m: f64, class: Option<&str>) -> bool {
        self.min_width_m.is_none_or(|least| width_m >= least)
            && self.max_width_m.is_none_or(|most| width_m < most)
            && self.class.as_deref().is_none_or(|wanted| class == Some(wanted))
    }
}

fn wrong(field: String, found: impl ToString, expected: impl ToString) -> ConfigError {
    ConfigError::Value { field, found: found.to_string(), expected: expected.to_string() }
}

impl SortConfig {
    /// True for the text of a file with several arms.
    pub fn is_one(text: &str) -> bool {
        toml::from_str::<toml::Table>(text).is_ok_and(|table| table.contains_key("arms"))
    }

    /// Reads a file's text. Not yet checked: see [`SortConfig::check`].
    ///
    /// # Errors
    /// [`ConfigError::Toml`].
    pub fn parse(text: &str) -> Result<Self, ConfigError> {
        toml::from_str(text).map_err(|e| ConfigError::Toml(e.to_string().trim_end().to_owned()))
    }

    /// What one arm of the cell is to a run: its own devices, home and first bin, and what all share.
    pub fn cell(&self, arm: &ArmStation) -> CellConfig {
        let first = arm.bins.first().and_then(|name| self.bin(name));
        CellConfig {
            // Several arms look from above.
            servo: None,
            planner: self.planner.clone(),
            camera: self.camera.clone(),
            arm: arm.arm.clone(),
            hand: arm.hand.clone(),
            tray: self.tray.clone(),
            drop: DropConfig {
                position_m: first.map_or(arm.home_m, |bin| bin.position_m),
                yaw_rad: arm.yaw_rad,
            },
            motion: MotionConfig { wait_position_m: Some(arm.home_m), ..self.motion.clone() },
            timeouts: self.timeouts.clone(),
            recovery: self.recovery.clone(),
            run: self.run.clone(),
            recording: RecordingConfig {
                folder: self.recording.folder.as_ref().map(|folder| folder.join(&arm.name)),
            },
            simulation: self.simulation.clone(),
        }
    }

    /// Leaves out all arms but these, with their bins, and rules that no bin is left for.
    pub fn keep(&mut self, names: &[String]) {
        self.arms.retain(|arm| names.contains(&arm.name));
        let arms = &self.arms;
        self.bins.retain(|bin| arms.iter().any(|arm| arm.bins.contains(&bin.name)));
        let bins = &self.bins;
        for rule in &mut self.rules {
            rule.bins.retain(|name| bins.iter().any(|bin| bin.name == *name));
        }
        self.rules.retain(|rule| !rule.bins.is_empty());
    }

    /// A bin by its name.
    pub fn bin(&self, name: &str) -> Option<&BinConfig> {
        self.bins.iter().find(|bin| bin.name == name)
    }

    /// Checks every value.
    ///
    /// # Errors
    /// [`ConfigError::Value`] with the first field that is wrong, what was found and what was expected.
    pub fn check(&self) -> Result<(), ConfigError> {
        self.check_lists()?;
        for (i, arm) in self.arms.iter().enumerate() {
            let at = |field: &str| format!("arms[{i}].{field}");
            self.cell(arm).check().map_err(|error| match error {
                ConfigError::Value { field, found, expected } => ConfigError::Value {
                    field: format!("arms[{i}] ({}): {field}", arm.name),
                    found,
                    expected,
                },
                other => other,
            })?;
            let [min, max] = arm.opening_m;
            if !(min >= 0.0 && max > min && max <= 1.0) {
                let expected = "two widths in metres, the second larger, at most 1";
                return Err(wrong(at("opening_m"), format!("{:?}", arm.opening_m), expected));
            }
            if let Some(radius) = arm.hand_radius_m.filter(|r| !(*r > 0.0 && *r <= 1.0)) {
                return Err(wrong(at("hand_radius_m"), radius, "more than 0, at most 1"));
            }
            let numbers = arm.base_m.iter().chain(&arm.home_m).chain([&arm.yaw_rad, &arm.base_yaw_rad]);
            if let Some(bad) = numbers.into_iter().find(|v| !(v.is_finite() && v.abs() <= 100.0)) {
                return Err(wrong(at("base_m, home_m, yaw_rad"), bad, "numbers within 100"));
            }
        }
        let s = &self.sort;
        for (field, value, most) in [
            ("lease_s", s.lease_s, 3600.0),
            ("come_back_s", s.come_back_s, 3600.0),
            ("assign_s", s.assign_s, 10.0),
            ("object_height_m", s.object_height_m, 0.2),
        ] {
            if !(value > 0.0 && value <= most) {
                return Err(wrong(format!("sort.{field}"), value, format!("more than 0, at most {most}")));
            }
        }
        for (field, value) in [("clearance_m", s.clearance_m), ("disturbed_m", s.disturbed_m)] {
            if !(0.0..=1.0).contains(&value) {
                return Err(wrong(format!("sort.{field}"), value, "0 to 1"));
            }
        }
        Ok(())
    }

    /// Names, and who delivers where.
    fn check_lists(&self) -> Result<(), ConfigError> {
        let names = |list: &'static str, names: Vec<&String>| {
            let mut seen = BTreeSet::new();
            let plain = |c: char| c.is_ascii_alphanumeric() || "-_".contains(c);
            for (i, name) in names.iter().enumerate() {
                let fine = !name.is_empty() && name.chars().all(plain) && seen.insert(*name);
                if !fine {
                    let expected = "a name of its own of letters, digits, - and _";
                    return Err(wrong(format!("{list}[{i}].name"), format!("{name:?}"), expected));
                }
            }
            if names.is_empty() { Err(wrong(list.to_owned(), "none", "at least one")) } else { Ok(()) }
        };
        names("arms", self.arms.iter().map(|a| &a.name).collect())?;
        names("bins", self.bins.iter().map(|b| &b.name).collect())?;
        names("rules", self.rules.iter().map(|r| &r.name).collect())?;
        let mut owned = BTreeSet::new();
        let known: Vec<&str> = self.bins.iter().map(|b| b.name.as_str()).collect();
        for (i, arm) in self.arms.iter().enumerate() {
            let field = format!("arms[{i}].bins");
            if arm.bins.is_empty() {
                return Err(wrong(field, "none", format!("some of {}", known.join(", "))));
            }
            for bin in &arm.bins {
                if self.bin(bin).is_none() {
                    return Err(wrong(field, format!("{bin:?}"), format!("one of {}", known.join(", "))));
                }
                if !owned.insert(bin) {
                    let expected = "a bin of this arm alone: arms do not meet over bins";
                    return Err(wrong(field, format!("{bin:?}"), expected));
                }
            }
        }
        for (i, rule) in self.rules.iter().enumerate() {
            let field = format!("rules[{i}].bins");
            if let Some(bin) = rule.bins.iter().find(|bin| !owned.contains(bin)) {
                return Err(wrong(field, format!("{bin:?}"), "a bin that an arm delivers to"));
            }
            if rule.bins.is_empty() {
                return Err(wrong(field, "none", "at least one bin"));
            }
        }
        Ok(())
    }
}
