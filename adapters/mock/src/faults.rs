//! What can go wrong with a mock device, as configuration.

use serde::{Deserialize, Serialize};

/// How long something goes on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Spell {
    /// For this many calls.
    Calls(u32),
    /// For this many seconds on the world's clock, from when the fault was set.
    Seconds(f64),
    /// Until it is taken back.
    Forever,
}

/// Frames that come late: the driver hands over images from a queue that has grown.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stale {
    /// Share of the frames, 0 to 1.
    pub share: f64,
    /// How much older than by latency alone they are, seconds.
    pub age_s: f64,
}

/// How far into a motion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum After {
    /// Metres of the flange's path.
    Metres(f64),
    /// Seconds.
    Seconds(f64),
}

/// Which stop an arm makes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StopKind {
    /// Released by `clear_fault`.
    Protective,
    /// The button is pressed: [`Faults::emergency_stop`] becomes true.
    Emergency,
}

/// An arm stops itself in the middle of its next motion that lasts long enough; once.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionFault {
    /// How far into the motion.
    pub after: After,
    /// Which stop.
    pub kind: StopKind,
}

/// A hand's motor reports overload in its next grip that lasts long enough; once. Its fingers then have no force.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Overload {
    /// Seconds into the grip.
    pub after_s: f64,
}

/// What goes wrong with one device. The default: nothing. Fields that do not concern a kind of device do nothing
/// to it.
///
/// What a caller gets: [`Faults::refused`] gives `Disconnected`, [`Faults::silent`] `Timeout`, lost frames nothing
/// while a later one comes in time and else `Timeout`, late frames and a stuck camera `Stale`, the stops
/// `Fault { ProtectiveStop | EmergencyStop }`, an overload `Fault { Overload }`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Faults {
    /// Decides all that is drawn: jitter, which frames are lost, which are late, and a camera's noise.
    pub seed: u64,
    /// Seconds from a call to when the device hears it; for a camera, from exposure to delivery.
    pub latency_s: f64,
    /// Latency is longer by up to this many seconds, evenly drawn.
    pub jitter_s: f64,
    /// Connections are refused. Each refused call takes 0.1 s.
    pub refused: Option<Spell>,
    /// The device neither does nor answers what it is asked. Set during a call (`seconds` or `forever`), the
    /// device does what it was asked and its answer is lost.
    pub silent: Option<Spell>,
    /// Camera: share of the frames that never arrive, 0 to 1.
    pub drop_share: f64,
    /// Camera: frames that arrive late.
    pub stale: Option<Stale>,
    /// Camera: it delivers one exposure again and again.
    pub stuck: bool,
    /// Arm: it stops itself in the middle of a motion.
    pub motion: Option<MotionFault>,
    /// Arm: the emergency stop is pressed. After it has been released, `clear_fault` makes the arm ready again.
    pub emergency_stop: bool,
    /// Hand: a motor is overloaded.
    pub overload: Option<Overload>,
}

/// A fault that cannot be.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("faults.{field}: found {found}, expected {expected}")]
pub struct FaultsError {
    /// The field.
    pub field: &'static str,
    /// Found value.
    pub found: f64,
    /// What is expected.
    pub expected: &'static str,
}

impl Faults {
    /// Checks every number.
    ///
    /// # Errors
    /// The first field that is not a time or a share.
    pub fn check(&self) -> Result<(), FaultsError> {
        let time = |field, found: f64| {
            let fine = found.is_finite() && found >= 0.0;
            fine.then_some(()).ok_or(FaultsError { field, found, expected: "a number of at least 0" })
        };
        let share = |field, found: f64| {
            let fine = (0.0..=1.0).contains(&found);
            fine.then_some(()).ok_or(FaultsError { field, found, expected: "a share from 0 to 1" })
        };
        time("latency_s", self.latency_s)?;
        time("jitter_s", self.jitter_s)?;
        share("drop_share", self.drop_share)?;
        for (field, spell) in [("refused", self.refused), ("silent", self.silent)] {
            if let Some(Spell::Seconds(seconds)) = spell {
                time(field, seconds)?;
            }
        }
        if let Some(stale) = self.stale {
            share("stale.share", stale.share)?;
            time("stale.age_s", stale.age_s)?;
        }
        if let Some(MotionFault { after: After::Metres(x) | After::Seconds(x), .. }) = self.motion {
            time("motion.after", x)?;
        }
        self.overload.map_or(Ok(()), |o| time("overload.after_s", o.after_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_configuration_reads_as_it_is_written() {
        let text = r#"
            latency_s = 0.02
            refused = { calls = 3 }
            silent = "forever"
            stale = { share = 0.5, age_s = 1.0 }
            motion = { after = { metres = 0.05 }, kind = "protective" }
        "#;
        let faults: Faults = toml::from_str(text).unwrap();
        assert_eq!(faults.refused, Some(Spell::Calls(3)));
        assert_eq!(faults.silent, Some(Spell::Forever));
        assert_eq!(
            faults.motion,
            Some(MotionFault { after: After::Metres(0.05), kind: StopKind::Protective })
        );
        assert_eq!(faults.check(), Ok(()));
        let again: Faults = toml::from_str(&toml::to_string(&faults).unwrap()).unwrap();
        assert_eq!(again, faults);
        assert!(toml::from_str::<Faults>("latency = 1.0").is_err());
    }

    #[test]
    fn impossible_numbers_are_named() {
        let with = |change: fn(&mut Faults)| {
            let mut faults = Faults::default();
            change(&mut faults);
            faults.check().map_err(|e| e.field)
        };
        assert_eq!(with(|_| ()), Ok(()));
        assert_eq!(with(|f| f.drop_share = 1.5), Err("drop_share"));
        assert_eq!(with(|f| f.latency_s = f64::NAN), Err("latency_s"));
        assert_eq!(with(|f| f.jitter_s = -1.0), Err("jitter_s"));
        assert_eq!(with(|f| f.refused = Some(Spell::Seconds(-1.0))), Err("refused"));
        assert_eq!(with(|f| f.stale = Some(Stale { share: 2.0, age_s: 0.0 })), Err("stale.share"));
        assert_eq!(with(|f| f.overload = Some(Overload { after_s: f64::INFINITY })), Err("overload.after_s"));
    }
}
