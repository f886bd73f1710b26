//! How long it takes, against an emulated controller in the same process: from a command to motion, between frames of
//! state, and how many targets of a stream go through.
//!
//! `cargo run -p graspd-adapters-ur --example latency`

use std::time::{Duration, Instant};

use graspd_adapters_core::{Arm, Limits};
use graspd_adapters_emulators::ur::{UrEmulator, UrPorts, UrSettings};
use graspd_adapters_ur::{Ports, ServoSettings, UrArm, UrConfig};

const SOON: Duration = Duration::from_secs(5);

fn shares(name: &str, mut times: Vec<Duration>) {
    times.sort();
    let at = |share: f64| times[((times.len() - 1) as f64 * share) as usize].as_secs_f64() * 1e3;
    println!(
        "{name}: p50 {:.2} ms, p99 {:.2} ms, most {:.2} ms of {}",
        at(0.5),
        at(0.99),
        at(1.0),
        times.len()
    );
}

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let emulator = UrEmulator::start(UrSettings { ports: UrPorts::FREE, ..UrSettings::default() }).await?;
    let addresses = emulator.addresses();
    let ports = Ports {
        rtde: addresses.rtde.port(),
        dashboard: addresses.dashboard.port(),
        primary: addresses.primary.port(),
    };
    let arm = UrArm::new(UrConfig { host: "127.0.0.1".into(), armed: true, ports, ..UrConfig::default() })?;
    arm.state(SOON).await?;

    let (mut gaps, mut last, mut stamp) = (Vec::new(), Instant::now(), 0.0);
    while gaps.len() < 2000 {
        let now = arm.robot_state(SOON).await?.timestamp_s;
        if now != stamp {
            stamp = now;
            gaps.push(last.elapsed());
            last = Instant::now();
        }
        tokio::time::sleep(Duration::from_micros(100)).await;
    }
    shares("between frames of state", gaps.split_off(1));

    let limits = Limits { speed_m_s: 0.25, acceleration_m_s2: 1.0 };
    let home = arm.robot_state(SOON).await?.joints;
    let began = Instant::now();
    arm.move_joints(&home, limits, SOON).await?;
    println!(
        "upload of the control script and a motion of nothing: {:.1} ms",
        began.elapsed().as_secs_f64() * 1e3
    );
    let mut starts = Vec::new();
    for round in 0..40 {
        let mut goal = home;
        goal[5] += if round % 2 == 0 { 0.3 } else { 0.0 };
        let began = Instant::now();
        let moving = async {
            while emulator.snapshot().target_speeds.iter().all(|v| v.abs() < 1e-6) {
                tokio::time::sleep(Duration::from_micros(100)).await;
            }
            starts.push(began.elapsed());
        };
        let (moved, ()) = tokio::join!(arm.move_joints(&goal, limits, SOON), moving);
        moved?;
    }
    shares("from a command to motion", starts);

    let mut stream = arm.servo_joints(ServoSettings::default(), limits, SOON).await?;
    let mut clock = tokio::time::interval(Duration::from_millis(2));
    clock.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut target = arm.robot_state(SOON).await?.joints;
    let (mut refused, began) = (0, Instant::now());
    for _ in 0..1000 {
        clock.tick().await;
        target[5] += 0.0005;
        refused += u32::from(stream.send_joints(&target).is_err());
    }
    let rate = 1000.0 / began.elapsed().as_secs_f64();
    println!("stream: {rate:.0} targets a second, {refused} refused");
    stream.finish(SOON).await?;
    Ok(())
}
