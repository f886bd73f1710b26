//! Bounds of a world's settings: within them every step of the engine and of the hands' motors is defined.

use super::fields::within;
use super::{FARTHEST_M, SceneError};
use crate::world::{HandSettings, WorldSettings};

/// `Ok` when every number is within its bounds; they are wide, they keep out what no world is made of.
pub(super) fn check(s: &WorldSettings) -> Result<(), SceneError> {
    let check = |field: &str, value, low, high| within("settings", field, value, low, high);
    check("dt_s", s.dt_s, 1e-5, 0.02)?;
    check("solver_iterations", s.solver_iterations as f64, 1.0, 1000.0)?;
    check("contact_hz", s.contact_hz, 1.0, 10_000.0)?;
    check("gravity", s.gravity, 0.0, 100.0)?;
    check("table_half_extent_m", s.table_half_extent_m, 0.05, FARTHEST_M)?;
    check("table_friction", s.table_friction, 0.0, 10.0)?;
    check("table_surface.albedo", s.table_surface.albedo, 0.0, 1.0)?;
    check("table_surface.specular", s.table_surface.specular, 0.0, 1.0)?;
    if let Some(tray) = &s.tray {
        check("tray.width_m", tray.width_m, 0.02, FARTHEST_M)?;
        check("tray.length_m", tray.length_m, 0.02, FARTHEST_M)?;
        check("tray.height_m", tray.height_m, 0.001, 1.0)?;
        check("tray.wall_m", tray.wall_m, 0.001, 0.5)?;
    }
    check_hands(&s.hands)
}

fn check_hands(s: &HandSettings) -> Result<(), SceneError> {
    // Taken apart, so that a new field cannot be forgotten.
    let HandSettings {
        pad_friction,
        link_friction,
        arm_mass_kg,
        arm_force_n,
        link_density,
        link_mass_kg,
        armature_kg_m2,
        armature_kg,
        fingertip_force_n,
        most_fingertip_force_n,
        turn_rad_s,
        slide_m_s,
        full_effort_rad,
        full_effort_m,
        back_drive,
        servo_time_s,
        adaptive_stiffness,
        adaptive_time_s,
        adaptive_share,
    } = *s;
    let bounds = [
        ("pad_friction", pad_friction, 0.0, 10.0),
        ("link_friction", link_friction, 0.0, 10.0),
        ("arm_mass_kg", arm_mass_kg, 0.1, 1000.0),
        ("arm_force_n", arm_force_n, 0.1, 1e5),
        ("link_density", link_density, 1.0, 1e5),
        ("link_mass_kg", link_mass_kg, 1e-4, 10.0),
        ("armature_kg_m2", armature_kg_m2, 1e-7, 1.0),
        ("armature_kg", armature_kg, 1e-4, 100.0),
        ("fingertip_force_n", fingertip_force_n, 0.01, 1e4),
        ("most_fingertip_force_n", most_fingertip_force_n, 0.01, 1e4),
        ("turn_rad_s", turn_rad_s, 1e-3, 100.0),
        ("slide_m_s", slide_m_s, 1e-4, 10.0),
        ("full_effort_rad", full_effort_rad, 1e-3, 10.0),
        ("full_effort_m", full_effort_m, 1e-5, 1.0),
        ("back_drive", back_drive, 0.0, 1000.0),
        ("servo_time_s", servo_time_s, 1e-4, 1.0),
        ("adaptive_stiffness", adaptive_stiffness, 1e-4, 1000.0),
        ("adaptive_time_s", adaptive_time_s, 1e-4, 10.0),
        ("adaptive_share", adaptive_share, 0.0, 10.0),
    ];
    bounds
        .into_iter()
        .try_for_each(|(field, value, low, high)| within("settings.hands", field, value, low, high))
}
