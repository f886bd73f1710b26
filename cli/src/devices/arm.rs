//! Arms that are reached over a wire.

use std::sync::Arc;

use anyhow::Context as _;
use graspd_adapters_emulators::ur::{Plant, UrEmulator, UrModel, UrPorts, UrSettings};
use graspd_adapters_ur::{Ports, UrArm, UrConfig};
use graspd_cell::config::CellConfig;
use nalgebra::Isometry3;

use super::{EMULATOR, sections};

/// An arm, and the emulator behind its wire where it is emulated in this process.
#[derive(Debug)]
pub(crate) struct WiredArm {
    pub(crate) arm: Arc<UrArm>,
    pub(crate) emulator: Option<Arc<UrEmulator>>,
}

/// Settings of the arm, as the cell's file says.
///
/// # Errors
/// For a table that is not in order, and for bounds that the cell's own speeds and forces do not keep.
pub(crate) fn settings(config: &CellConfig) -> anyhow::Result<UrConfig> {
    let [_, section, _] = sections(config);
    section.check()?;
    let mut settings: UrConfig = section.settings(&[("host", "address"), ("armed", "armed")])?;
    settings.host.clone_from(&config.arm.address);
    settings.armed = config.arm.armed;
    settings.check().context("arm.settings.ur")?;
    let (cell, limits) = (&config.arm, &settings.limits);
    for (field, value, limit, most) in [
        ("arm.speed_m_s", cell.speed_m_s, "speed_m_s", limits.speed_m_s),
        ("arm.approach_speed_m_s", cell.approach_speed_m_s, "speed_m_s", limits.speed_m_s),
        ("arm.lift_speed_m_s", cell.lift_speed_m_s, "speed_m_s", limits.speed_m_s),
        ("arm.carry_speed_m_s", cell.carry_speed_m_s, "speed_m_s", limits.speed_m_s),
        ("arm.acceleration_m_s2", cell.acceleration_m_s2, "acceleration_m_s2", limits.acceleration_m_s2),
        ("motion.contact_force_n", config.motion.contact_force_n, "force_n", limits.force_n),
    ] {
        anyhow::ensure!(
            value <= most,
            "{field}: found {value}, expected at most {most}: arm.settings.ur.limits.{limit} forbids more"
        );
    }
    Ok(settings)
}

/// The emulated arm of these settings.
///
/// # Errors
/// For a model that is not emulated.
pub(crate) fn model(settings: &UrConfig) -> anyhow::Result<UrModel> {
    let name = settings.model.name().to_lowercase();
    let known = UrModel::ALL.iter().find(|(_, known)| *known == name);
    known.map(|(model, _)| *model).with_context(|| format!("arm.settings.ur.model: {name} is not emulated"))
}

/// Joints with which an arm holds its hand at a pose, elbow up where it can be.
///
/// # Errors
/// For a pose that the arm does not reach.
pub(crate) fn joints_at(settings: &UrConfig, world_from_hand: &Isometry3<f64>) -> anyhow::Result<[f64; 6]> {
    use graspd_adapters_ur::kinematics::{Kinematics, joint_distance};
    use std::f64::consts::FRAC_PI_2;
    let arm = Kinematics::new(settings.model);
    let goal = settings.world_from_base().inverse() * world_from_hand * settings.flange_from_hand().inverse();
    let towards = goal.translation.vector.y.atan2(goal.translation.vector.x);
    // A base at zero reaches towards its -x.
    let usual = [towards + 2.0 * FRAC_PI_2, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, -FRAC_PI_2, 0.0];
    let usual = usual.map(|q| if q > 2.0 * FRAC_PI_2 { q - 4.0 * FRAC_PI_2 } else { q });
    let postures = arm.inverse(&goal, 0.0);
    let near = postures.iter().filter_map(|s| arm.limits().nearest_turns(&s.joints, &usual));
    let best = near.min_by(|a, b| joint_distance(a, &usual).total_cmp(&joint_distance(b, &usual)));
    best.with_context(|| {
        let at = world_from_hand.translation.vector;
        format!(
            "arm.settings.ur.world_from_base: the arm does not reach its first pose, with the hand at {:.3?}",
            at.as_slice()
        )
    })
}

/// Connects to the arm; one that is emulated is started first, with a body of one's own where one is given.
///
/// # Errors
/// As [`settings`]; an emulator that cannot listen. Whether anybody answers shows with the first call.
pub(crate) async fn connect(
    config: &CellConfig,
    body: Option<(Box<dyn Plant>, [f64; 6])>,
) -> anyhow::Result<WiredArm> {
    let mut settings = settings(config)?;
    if config.arm.address != EMULATOR {
        return Ok(WiredArm { arm: Arc::new(UrArm::new(settings)?), emulator: None });
    }
    let emulated = UrSettings { ports: UrPorts::FREE, ..UrSettings::of(model(&settings)?) };
    let emulator = match body {
        Some((plant, joints)) => {
            UrEmulator::start_with(UrSettings { joints: Some(joints), ..emulated }, plant).await
        }
        None => UrEmulator::start(emulated).await,
    };
    let emulator = emulator.context("the emulated arm cannot listen")?;
    let at = emulator.addresses();
    settings.host = at.rtde.ip().to_string();
    let (rtde, dashboard, primary) = (at.rtde.port(), at.dashboard.port(), at.primary.port());
    settings.ports = Ports { rtde, dashboard, primary };
    Ok(WiredArm { arm: Arc::new(UrArm::new(settings)?), emulator: Some(Arc::new(emulator)) })
}
