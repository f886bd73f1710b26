//! Activates a gripper, closes it, opens it, and says what it reports.
//!
//! `cargo run -p graspd-adapters-robotiq --example grip -- rtu:/dev/ttyUSB0`, `tcp:HOST:PORT`, `rtu_over_tcp:HOST:PORT` or
//! `socket:HOST:PORT`. With a second argument `1000`, a slave on Modbus TCP has the registers of RTU. The fingers move: keep hands and things out of them.

use std::time::{Duration, Instant};

use graspd_adapters_core::{GripCommand, Hand};
use graspd_adapters_robotiq::settings::LinkSettings;
use graspd_adapters_robotiq::{RobotiqHand, RobotiqSettings};

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let place = std::env::args().nth(1).ok_or("where? for example rtu:/dev/ttyUSB0")?;
    let (kind, at) = place.split_once(':').ok_or("a kind and a place, for example rtu:/dev/ttyUSB0")?;
    let address = at.to_owned();
    let link = match kind {
        "rtu" => LinkSettings::Rtu { port: address, baud: 115_200 },
        "tcp" => LinkSettings::ModbusTcp { address },
        "rtu_over_tcp" => LinkSettings::RtuOverTcp { address },
        "socket" => LinkSettings::Socket { address },
        other => return Err(format!("unknown kind {other}").into()),
    };
    let as_rtu = std::env::args().nth(2).is_some_and(|first| first == "1000");
    let registers = as_rtu.then_some([2000, 1000]);
    let hand =
        RobotiqHand::new(RobotiqSettings { link, registers, armed: true, ..RobotiqSettings::default() })?;
    let patience = Duration::from_secs(30);
    for finding in hand.check(patience).await? {
        println!("{}: {} {}", finding.subject, finding.found, finding.advice);
    }
    hand.clear_fault(patience).await?;
    println!("activated");
    for metres in [0.0, 0.02, 0.0425, 0.0] {
        let command = GripCommand { actuators: vec![metres], speed: 1.0, force: 0.5 };
        let state = hand.grip(&command, patience).await?;
        println!("asked {metres} reached {:.4} held {:?}", state.actuators[0], state.held);
    }
    let mut times = Vec::new();
    for _ in 0..200 {
        let began = Instant::now();
        hand.state(patience).await?;
        times.push(began.elapsed());
    }
    times.sort();
    println!("state: p50 {:.1?} p99 {:.1?}", times[99], times[197]);
    Ok(())
}
