//! How attempts and runs end.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Why a grasp trial failed, as the cell sees it (Supplementary Fig. 8 names the causes).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FailureClass {
    /// The hand met the table or an object on the straight approach, and held nothing afterwards (Fig. 8b, c).
    Collision,
    /// The fingers closed on nothing, or on too little (Fig. 8a, d, e).
    UnstableContact,
    /// The object left the hand while it was lifted.
    LostLifting,
    /// The object left the hand on the way to the drop pose.
    LostCarrying,
    /// The hand felt the object to the end, and yet it did not arrive: only a witness can know.
    NotDelivered,
    /// A device failed.
    Device,
}

impl FailureClass {
    /// The class's name in records and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Collision => "collision",
            Self::UnstableContact => "unstable_contact",
            Self::LostLifting => "lost_lifting",
            Self::LostCarrying => "lost_carrying",
            Self::NotDelivered => "not_delivered",
            Self::Device => "device",
        }
    }
}

/// How one attempt ended. Every attempt has exactly one outcome.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "result")]
pub enum Outcome {
    /// An object was picked from the tray and dropped at the targeted place.
    Success,
    /// The grasp was executed and failed.
    Failed {
        /// Class.
        class: FailureClass,
        /// What happened.
        why: String,
    },
    /// No grasp was executed: nothing to grasp, no grasp, or trouble before the approach. Not a trial.
    NotExecuted {
        /// What happened.
        why: String,
    },
    /// The run ended with something that may be in the hand: a person has to look.
    Unknown {
        /// What happened.
        why: String,
    },
}

/// What is in the hand when a run ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Holding {
    /// The hand is empty.
    Nothing,
    /// The hand feels an object.
    Object,
    /// Nobody knows: the hand does not say.
    Unknown,
}

/// Why a run ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "end")]
pub enum End {
    /// The tray is empty: the planner sees nothing in it.
    Empty,
    /// The allowed grasp trials are used up.
    Trials,
    /// The time limit.
    TimeLimit,
    /// Too many failed attempts in a row.
    Failures {
        /// The last failure.
        last: String,
    },
    /// The planner has no grasp for what it sees.
    NoGrasp {
        /// The planner's reasons.
        why: String,
    },
    /// The camera gives no frames.
    CameraLost {
        /// Its last error.
        why: String,
    },
    /// The arm does not do what it is asked.
    ArmLost {
        /// Its last error.
        why: String,
    },
    /// The hand does not do what it is asked.
    HandLost {
        /// Its last error.
        why: String,
    },
    /// The planner did not answer until the time limit, or failed again and again.
    PlannerLost {
        /// Its last error.
        why: String,
    },
    /// The planner refuses the request.
    PlannerRefused {
        /// Its error.
        why: String,
    },
    /// An emergency stop: a person is needed.
    EmergencyStop {
        /// The device's words.
        why: String,
    },
    /// Somebody asked the run to end.
    Asked,
}

impl End {
    /// True when the tray was cleared.
    pub fn is_clear(&self) -> bool {
        matches!(self, Self::Empty)
    }

    /// True when a person has to look before the next run.
    pub fn needs_person(&self) -> bool {
        matches!(self, Self::ArmLost { .. } | Self::HandLost { .. } | Self::EmergencyStop { .. })
    }
}

impl fmt::Display for End {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty => f.write_str("the tray is empty"),
            Self::Trials => f.write_str("all allowed grasp trials are used up"),
            Self::TimeLimit => f.write_str("the time limit"),
            Self::Failures { last } => write!(f, "too many failed attempts in a row; the last: {last}"),
            Self::NoGrasp { why } => write!(f, "no grasp for what is seen: {why}"),
            Self::CameraLost { why } => write!(f, "no frames: {why}"),
            Self::ArmLost { why } => write!(f, "the arm failed, a person has to look: {why}"),
            Self::HandLost { why } => write!(f, "the hand failed, a person has to look: {why}"),
            Self::PlannerLost { why } | Self::PlannerRefused { why } => f.write_str(why),
            Self::EmergencyStop { why } => write!(f, "emergency stop, a person is needed: {why}"),
            Self::Asked => f.write_str("it was asked to end"),
        }
    }
}
