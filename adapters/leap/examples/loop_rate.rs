//! How often a second all joints can be read and told, over the emulated bus with its time on the wire.
//!
//! `cargo run --release -p graspd-adapters-leap --example loop_rate -- [EXCHANGES]`

use std::time::{Duration, Instant};

use graspd_adapters_core::{DeviceError, GripCommand, Hand};
use graspd_adapters_dynamixel::table;
use graspd_adapters_emulators::dynamixel::{BusConfig, BusEmulator, KinematicPlant};
use graspd_adapters_leap::bus::{Bus, BusError, FEEDBACK};
use graspd_adapters_leap::{LeapHand, LeapSettings};

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let exchanges: usize = std::env::args().nth(1).map_or(Ok(2000), |n| n.parse())?;
    println!("16 motors, 4 Mbps, 10 bytes read and 4 written of each, {exchanges} times");
    for (name, fast, latency_ms) in
        [("fast sync read", true, 0), ("sync read", false, 0), ("fast sync read, USB latency 1 ms", true, 1)]
    {
        let latency = Duration::from_millis(latency_ms);
        let config = BusConfig { latency, return_delay: 0, ..BusConfig::leap(false) };
        let emulator = BusEmulator::start(config, KinematicPlant::new())?;
        let path = emulator.path().display().to_string();
        let mut bus = Bus::open(&path, 4_000_000, Duration::from_millis(20), 3).await?;
        let mut times = measure(&mut bus, fast, exchanges).await?;
        times.sort();
        let total: Duration = times.iter().sum();
        let at = |q: f64| times[((times.len() - 1) as f64 * q) as usize].as_secs_f64() * 1e3;
        let rate = times.len() as f64 / total.as_secs_f64();
        println!(
            "{name}: {rate:.0} Hz; p50 {:.2} ms, p99 {:.2} ms, longest {:.2} ms",
            at(0.5),
            at(0.99),
            at(1.0)
        );
    }
    whole_hand().await
}

/// The hand's own loop at a few rates, while its fingers move: every call for its state waits for the next reading.
async fn whole_hand() -> Result<(), Box<dyn std::error::Error>> {
    for rate_hz in [100.0, 200.0] {
        let emulator = BusEmulator::start(BusConfig::leap(false), KinematicPlant::new())?;
        let port = emulator.path().display().to_string();
        let settings =
            LeapSettings { port, armed: true, rate_hz, max_speed_rad_s: 0.2, ..LeapSettings::default() };
        let hand = LeapHand::new(settings)?;
        let patience = Duration::from_secs(20);
        let mut command = GripCommand { actuators: vec![0.0; 16], speed: 1.0, force: 0.5 };
        hand.grip(&command, patience).await?;
        command.actuators.fill(0.9);
        let states = async {
            let mut times = Vec::new();
            let began = Instant::now();
            while began.elapsed() < Duration::from_secs(5) {
                let asked = Instant::now();
                hand.state(patience).await?;
                times.push(asked.elapsed());
            }
            Ok::<_, DeviceError>((times, began.elapsed()))
        };
        let (moved, states) = tokio::join!(hand.grip(&command, patience), states);
        moved?;
        let (mut times, took) = states?;
        times.sort();
        let at = |q: f64| times[((times.len() - 1) as f64 * q) as usize].as_secs_f64() * 1e3;
        let rate = times.len() as f64 / took.as_secs_f64();
        println!("hand at {rate_hz} Hz: {rate:.1} Hz; p50 {:.2} ms, p99 {:.2} ms", at(0.5), at(0.99));
    }
    Ok(())
}

async fn measure(bus: &mut Bus, fast: bool, exchanges: usize) -> Result<Vec<Duration>, BusError> {
    let ids: Vec<u8> = (0..16).collect();
    let mut times = Vec::with_capacity(exchanges);
    for i in 0..exchanges {
        let began = Instant::now();
        bus.sync_read(FEEDBACK, &ids, fast).await?;
        let goal = 2048 + i32::try_from(i % 100).unwrap_or(0);
        bus.sync_write(table::GOAL_POSITION, ids.iter().map(|id| (*id, goal))).await?;
        times.push(began.elapsed());
    }
    Ok(times)
}
