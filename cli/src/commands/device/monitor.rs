//! `graspd device monitor`: what the devices of a cell report, again and again. Nothing moves.

use std::fmt::Write as _;
use std::io::{IsTerminal as _, Write as _};
use std::time::Duration;

use clap::Args;
use graspd_adapters_core::{Arm as _, DeviceError, Hand as _};
use graspd_adapters_robotiq::wire::Motion;
use graspd_cell::config::CellConfig;

use super::Which;
use super::check::seconds;
use crate::devices::arm::WiredArm;
use crate::devices::camera::AnyCamera;
use crate::devices::hand::{AnyHand, WiredHand};
use crate::devices::{self, sections};

/// Shows what the devices of a cell report, until it is interrupted; moves nothing. Redraws on a terminal, else writes
/// each table under the last.
#[derive(Debug, Clone, Args)]
pub(super) struct MonitorArgs {
    #[command(flatten)]
    which: Which,
    /// Seconds between two looks
    #[arg(long, value_name = "SECONDS", default_value_t = 0.5, value_parser = seconds)]
    every: f64,
    /// End after so many looks
    #[arg(long, value_name = "N")]
    count: Option<u64>,
}

/// The devices that are looked at.
struct Watched {
    camera: Option<AnyCamera>,
    arm: Option<WiredArm>,
    hand: Option<WiredHand>,
    /// Those of the simulated world, which is not there.
    mock: Vec<&'static str>,
}

pub(super) async fn run(args: &MonitorArgs) -> anyhow::Result<()> {
    let mut config = args.which.read()?;
    // Who watches moves nothing, and takes no registers that somebody else needs.
    (config.arm.armed, config.hand.armed) = (false, false);
    let watched = watched(args, &config).await?;
    let every = Duration::from_secs_f64(args.every);
    let redraws = std::io::stdout().is_terminal();
    let mut lines = 0;
    let mut looks = 0;
    let mut clock = tokio::time::interval(every);
    clock.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            _ = clock.tick() => {}
            _ = tokio::signal::ctrl_c() => return Ok(()),
        }
        let table = tokio::select! {
            table = table(&watched, every.max(Duration::from_millis(500))) => table,
            _ = tokio::signal::ctrl_c() => return Ok(()),
        };
        let mut out = std::io::stdout().lock();
        if redraws && lines > 0 {
            // Up to where the last table began, and all below is gone.
            write!(out, "\x1b[{lines}A\x1b[J")?;
        }
        write!(out, "{table}")?;
        if !redraws {
            writeln!(out)?;
        }
        out.flush()?;
        lines = table.lines().count();
        looks += 1;
        if args.count.is_some_and(|count| looks >= count) {
            return Ok(());
        }
    }
}

async fn watched(args: &MonitorArgs, config: &CellConfig) -> anyhow::Result<Watched> {
    let mut watched = Watched { camera: None, arm: None, hand: None, mock: Vec::new() };
    for section in sections(config).iter().filter(|s| args.which.wants(s.name)) {
        match section.name {
            name if section.is_mock() => watched.mock.push(name),
            "camera" => watched.camera = Some(devices::camera::connect(config).await?),
            "arm" => watched.arm = Some(devices::arm::connect(config, None).await?),
            _ => watched.hand = Some(devices::hand::connect(config, None)?),
        }
    }
    Ok(watched)
}

/// One look at all of them.
async fn table(watched: &Watched, timeout: Duration) -> String {
    let mut text = String::new();
    for name in &watched.mock {
        let _ = writeln!(text, "{name:<7} of the simulated world, which runs only within `graspd cell run`");
    }
    if let Some(camera) = &watched.camera
        && let Err(error) = camera.describe(&mut text, timeout).await
    {
        let _ = writeln!(text, "camera  {error}");
    }
    if let Some(wired) = &watched.arm
        && let Err(error) = arm(&mut text, wired, timeout).await
    {
        let _ = writeln!(text, "arm     {error}");
    }
    if let Some(wired) = &watched.hand
        && let Err(error) = hand(&mut text, wired, timeout).await
    {
        let _ = writeln!(text, "hand    {error}");
    }
    text
}

async fn arm(text: &mut String, wired: &WiredArm, timeout: Duration) -> Result<(), DeviceError> {
    let state = wired.arm.state(timeout).await?;
    let robot = wired.arm.robot_state(timeout).await?;
    let at = state.world_from_flange.translation.vector;
    let (roll, pitch, yaw) = state.world_from_flange.rotation.euler_angles();
    let [fx, fy, fz, ..] = robot.wrench;
    let _ = writeln!(
        text,
        "arm     {:?}; robot mode {:?}, safety {:?}, program {}, speed {:.0} %",
        state.mode,
        robot.robot_mode,
        robot.safety,
        if robot.program_running { "running" } else { "none" },
        100.0 * robot.speed_scaling
    );
    let angles = [roll, pitch, yaw].map(f64::to_degrees);
    let _ = writeln!(
        text,
        "  hand   {:8.3} {:8.3} {:8.3} m   {:7.1} {:7.1} {:7.1} deg   force {:6.1} N",
        at.x,
        at.y,
        at.z,
        angles[0],
        angles[1],
        angles[2],
        (fx * fx + fy * fy + fz * fz).sqrt()
    );
    let _ = write!(text, "  joints");
    for joint in &state.joints {
        let _ = write!(text, " {:8.1}", joint.to_degrees());
    }
    let _ = writeln!(text, " deg");
    Ok(())
}

async fn hand(text: &mut String, wired: &WiredHand, timeout: Duration) -> Result<(), DeviceError> {
    match &wired.hand {
        AnyHand::Robotiq(hand) => {
            let report = hand.report(timeout).await?;
            let fault = report.fault.map_or_else(|| "no fault".to_owned(), |fault| fault.to_string());
            let _ = writeln!(text, "hand    {:?}; {fault}", report.phase);
            for axis in &report.axes {
                let motion = match axis.motion {
                    Motion::Moving => "moving",
                    Motion::HeldOpening | Motion::HeldClosing => "held",
                    Motion::Reached => "there",
                };
                let _ = writeln!(
                    text,
                    "  {:<16} {:9.4}  count {:3}  {:6.0} mA  {motion}",
                    axis.actuator, axis.position, axis.count, axis.current_ma
                );
            }
        }
        AnyHand::Leap(hand) => {
            let (joints, state) = (hand.joints(timeout).await?, hand.state(timeout).await?);
            let _ = writeln!(text, "hand    {}", if state.settled { "at rest" } else { "moving" });
            for joint in &joints {
                let errors = if joint.errors.is_empty() { "ok".to_owned() } else { joint.errors.join(", ") };
                let _ = writeln!(
                    text,
                    "  {:<16} {:8.3} rad  {:7.2} rad/s  {:6.0} mA  {:3.0} C  {:4.1} V  {errors}",
                    joint.actuator,
                    joint.position_rad,
                    joint.velocity_rad_s,
                    joint.current_ma,
                    joint.temperature_c,
                    joint.voltage_v
                );
            }
        }
    }
    Ok(())
}
