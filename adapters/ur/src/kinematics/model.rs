//! Models of arms: the manufacturer's nominal Denavit-Hartenberg tables and limits.

use serde::{Deserialize, Serialize};

/// A model of the CB3 or e-Series.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Model {
    /// UR3 (CB3).
    Ur3,
    /// UR5 (CB3).
    Ur5,
    /// UR10 (CB3).
    Ur10,
    /// UR3e.
    Ur3e,
    /// UR5e.
    Ur5e,
    /// UR10e.
    Ur10e,
    /// UR16e.
    Ur16e,
}

/// Standard Denavit-Hartenberg parameters that are not zero; the twists are `[pi/2, 0, 0, pi/2, -pi/2, 0]` for all.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dh {
    /// Height of the shoulder, metres.
    pub d1: f64,
    /// Upper arm along x, metres, negative.
    pub a2: f64,
    /// Lower arm along x, metres, negative.
    pub a3: f64,
    /// Offset of wrist 1, metres.
    pub d4: f64,
    /// Offset of wrist 2, metres.
    pub d5: f64,
    /// Offset of wrist 3 (to the flange), metres.
    pub d6: f64,
}

impl Model {
    /// All models.
    pub const ALL: [Self; 7] =
        [Self::Ur3, Self::Ur5, Self::Ur10, Self::Ur3e, Self::Ur5e, Self::Ur10e, Self::Ur16e];

    /// Nominal geometry, as published by the manufacturer. A real arm's factory calibration differs by up to
    /// millimetres at the flange: its controller knows, this table does not.
    pub const fn dh(self) -> Dh {
        match self {
            Self::Ur3 => Dh { d1: 0.1519, a2: -0.24365, a3: -0.21325, d4: 0.11235, d5: 0.08535, d6: 0.0819 },
            Self::Ur5 => Dh { d1: 0.089159, a2: -0.425, a3: -0.39225, d4: 0.10915, d5: 0.09465, d6: 0.0823 },
            Self::Ur10 => Dh { d1: 0.1273, a2: -0.612, a3: -0.5723, d4: 0.163941, d5: 0.1157, d6: 0.0922 },
            Self::Ur3e => Dh { d1: 0.15185, a2: -0.24355, a3: -0.2132, d4: 0.13105, d5: 0.08535, d6: 0.0921 },
            Self::Ur5e => Dh { d1: 0.1625, a2: -0.425, a3: -0.3922, d4: 0.1333, d5: 0.0997, d6: 0.0996 },
            Self::Ur10e => {
                Dh { d1: 0.1807, a2: -0.6127, a3: -0.57155, d4: 0.17415, d5: 0.11985, d6: 0.11655 }
            }
            Self::Ur16e => Dh { d1: 0.1807, a2: -0.4784, a3: -0.36, d4: 0.17415, d5: 0.11985, d6: 0.11655 },
        }
    }

    /// Name as people write it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ur3 => "UR3",
            Self::Ur5 => "UR5",
            Self::Ur10 => "UR10",
            Self::Ur3e => "UR3e",
            Self::Ur5e => "UR5e",
            Self::Ur10e => "UR10e",
            Self::Ur16e => "UR16e",
        }
    }

    /// Published reach, metres.
    pub const fn reach_m(self) -> f64 {
        match self {
            Self::Ur3 | Self::Ur3e => 0.5,
            Self::Ur5 | Self::Ur5e => 0.85,
            Self::Ur10 | Self::Ur10e => 1.3,
            Self::Ur16e => 0.9,
        }
    }

    /// True for the e-Series: RTDE at up to 500 Hz, a force sensor in the flange.
    pub const fn is_e_series(self) -> bool {
        matches!(self, Self::Ur3e | Self::Ur5e | Self::Ur10e | Self::Ur16e)
    }

    /// Published largest speed of each joint, radians per second.
    pub const fn max_joint_speed(self) -> [f64; 6] {
        use std::f64::consts::{PI, TAU};
        const SLOW: f64 = PI * 120.0 / 180.0;
        match self {
            Self::Ur3 | Self::Ur3e => [PI, PI, PI, TAU, TAU, TAU],
            Self::Ur5 | Self::Ur5e => [PI; 6],
            Self::Ur10 | Self::Ur10e | Self::Ur16e => [SLOW, SLOW, PI, PI, PI, PI],
        }
    }
}
