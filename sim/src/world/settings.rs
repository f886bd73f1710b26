//! What a world is made of before anything is put into it.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// A tray on the table: four walls around a rectangle centred on the world's origin; its floor is the table.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tray {
    /// Inner width along x, metres.
    pub width_m: f64,
    /// Inner length along y, metres.
    pub length_m: f64,
    /// Height of the walls, metres.
    pub height_m: f64,
    /// Thickness of the walls, metres.
    pub wall_m: f64,
}

impl Default for Tray {
    /// A flat tray that fits the planner's 0.4 m workspace.
    fn default() -> Self {
        Self { width_m: 0.36, length_m: 0.36, height_m: 0.03, wall_m: 0.008 }
    }
}

impl Tray {
    /// Centre and half extents of the four walls, world frame.
    pub fn walls(&self) -> [(Vector3<f64>, Vector3<f64>); 4] {
        let (x, y, z, t) = (self.width_m / 2.0, self.length_m / 2.0, self.height_m / 2.0, self.wall_m / 2.0);
        let along_y = Vector3::new(t, y + 2.0 * t, z);
        let along_x = Vector3::new(x + 2.0 * t, t, z);
        [
            (Vector3::new(x + t, 0.0, z), along_y),
            (Vector3::new(-x - t, 0.0, z), along_y),
            (Vector3::new(0.0, y + t, z), along_x),
            (Vector3::new(0.0, -y - t, z), along_x),
        ]
    }
}

/// How hands behave in a world: what their descriptions do not say.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HandSettings {
    /// Coulomb friction of links that carry contact pads: rubber and silicone on plastics and paper, 0.8 to 1.0
    /// in engineering tables. A contact takes the mean of its two surfaces.
    pub pad_friction: f64,
    /// Coulomb friction of all other links: anodized aluminium and printed plastics.
    pub link_friction: f64,
    /// Mass that the arm shows at the wrist, kilograms: effective masses of lightweight arms are 4 to 20 kg.
    pub arm_mass_kg: f64,
    /// Largest force of the arm at the wrist, newtons: what stands in its way feels no more.
    pub arm_force_n: f64,
    /// Density of links, kilograms per cubic metre: descriptions carry no inertia.
    pub link_density: f64,
    /// Smallest mass of a link, kilograms.
    pub link_mass_kg: f64,
    /// Rotor inertia seen at a revolute joint through its gears, kilogram square metres.
    pub armature_kg_m2: f64,
    /// Rotor inertia seen at a prismatic joint, kilograms.
    pub armature_kg: f64,
    /// Force at the fingertips of an actuator whose effort nobody published, newtons.
    pub fingertip_force_n: f64,
    /// Largest force at the fingertips of a revolute actuator, newtons: efforts in URDFs are often placeholders
    /// (30 N m for a Barrett finger that presses with 20 N), and no hand of this size presses harder.
    pub most_fingertip_force_n: f64,
    /// Largest speed of a revolute actuator, radians per second, also where a description names none.
    pub turn_rad_s: f64,
    /// Largest speed of a prismatic actuator, metres per second, also where a description names none.
    pub slide_m_s: f64,
    /// Position error at which a revolute actuator gives its full effort, radians (a servo with proportional gain:
    /// 0.29 for LEAP's motors with their published gain of 600).
    pub full_effort_rad: f64,
    /// Position error at which a prismatic actuator gives its full effort, metres.
    pub full_effort_m: f64,
    /// Effort at which an actuator that presses with all it was allowed is pushed back, as a multiple of its full
    /// effort: worm gears, lead screws and high reductions hold more than the motor drives. 0: no more than that.
    pub back_drive: f64,
    /// Ratio of an actuator's damping to its stiffness, seconds.
    pub servo_time_s: f64,
    /// Stiffness with which adaptive joints return to what their mechanism prefers, share of the driving effort
    /// per radian.
    pub adaptive_stiffness: f64,
    /// Ratio of damping to that stiffness, seconds.
    pub adaptive_time_s: f64,
    /// Share of the driving torque that the mechanism hands on to adaptive joints, relative to the lever arms of
    /// the pads: below 1, so that a pinch at the tip does not curl the finger.
    pub adaptive_share: f64,
}

impl Default for HandSettings {
    fn default() -> Self {
        Self {
            pad_friction: 0.9,
            link_friction: 0.4,
            arm_mass_kg: 20.0,
            arm_force_n: 250.0,
            link_density: 1000.0,
            link_mass_kg: 0.01,
            armature_kg_m2: 1e-4,
            armature_kg: 0.1,
            fingertip_force_n: 25.0,
            most_fingertip_force_n: 80.0,
            turn_rad_s: 2.5,
            slide_m_s: 0.1,
            full_effort_rad: 0.2,
            full_effort_m: 0.004,
            back_drive: 2.0,
            servo_time_s: 0.02,
            adaptive_stiffness: 0.1,
            adaptive_time_s: 0.05,
            adaptive_share: 0.7,
        }
    }
}

/// Constants of a world.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WorldSettings {
    /// Length of a step, seconds.
    pub dt_s: f64,
    /// Iterations of the contact solver in a step.
    pub solver_iterations: usize,
    /// Natural frequency of contacts, hertz: how hard touching bodies are. At 200 a gripper's rubber pads give way
    /// by 0.2 mm under 100 N.
    pub contact_hz: f64,
    /// Acceleration towards −z, metres per second squared.
    pub gravity: f64,
    /// Half the side of the square table, metres.
    pub table_half_extent_m: f64,
    /// Coulomb friction of table and tray.
    pub table_friction: f64,
    /// What a depth camera gets back from table and tray.
    pub table_surface: crate::object::Surface,
    /// A tray on the table.
    pub tray: Option<Tray>,
    /// How hands behave.
    pub hands: HandSettings,
}

impl Default for WorldSettings {
    fn default() -> Self {
        Self {
            dt_s: 1.0 / 400.0,
            solver_iterations: 4,
            contact_hz: 200.0,
            gravity: 9.81,
            table_half_extent_m: 0.6,
            table_friction: 0.5,
            table_surface: crate::object::Surface::default(),
            tray: None,
            hands: HandSettings::default(),
        }
    }
}
