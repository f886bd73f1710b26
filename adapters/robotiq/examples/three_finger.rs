//! Activates a 3-Finger gripper, closes it in a mode, moves its fingers one by one, and says what it feels. Ends with an error
//! where fingers do not get where they are told.
//!
//! `cargo run -p graspd-adapters-robotiq --example three_finger -- rtu:/dev/ttyUSB0`, or `tcp:HOST:PORT`. The fingers move: keep
//! hands and things out of them.

use std::time::Duration;

use graspd_adapters_core::{GripCommand, Hand};
use graspd_adapters_robotiq::settings::LinkSettings;
use graspd_adapters_robotiq::wire::Mode;
use graspd_adapters_robotiq::{Model, RobotiqHand, RobotiqSettings};

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let place = std::env::args().nth(1).ok_or("where? for example rtu:/dev/ttyUSB0")?;
    let (kind, at) = place.split_once(':').ok_or("a kind and a place, for example rtu:/dev/ttyUSB0")?;
    let address = at.to_owned();
    let link = match kind {
        "rtu" => LinkSettings::Rtu { port: address, baud: 115_200 },
        "tcp" => LinkSettings::ModbusTcp { address },
        other => return Err(format!("unknown kind {other}").into()),
    };
    let model = Model::ThreeFinger;
    let hand = RobotiqHand::new(RobotiqSettings { model, link, armed: true, ..RobotiqSettings::default() })?;
    let patience = Duration::from_secs(40);
    for finding in hand.check(patience).await? {
        println!("{}: {} {}", finding.subject, finding.found, finding.advice);
    }
    hand.clear_fault(patience).await?;
    println!("activated");
    let state = hand.grip_in_mode(Mode::Pinch, 0.2, 1.0, 0.5, patience).await?;
    println!("pinch, a fifth closed: {:.3?} held {:?}", state.actuators, state.held);
    if hand.report(patience).await?.mode != Mode::Pinch {
        return Err("it is not in pinch mode".into());
    }
    // Scissor, finger 1 (B), finger 2 (C), middle (A); the first way meets nothing, on the second something is in the way of finger 1 at about 0.66 rad.
    for (asked, meets) in [([0.1, 0.3, 0.5, 0.7], false), ([0.0, 1.1, 0.9, 0.4], true), ([0.0; 4], false)] {
        let command = GripCommand { actuators: asked.to_vec(), speed: 1.0, force: 0.5 };
        let state = hand.grip(&command, patience).await?;
        println!("asked {asked:?} reached {:.3?} held {:?}", state.actuators, state.held);
        for (i, (asked, reached)) in asked.iter().zip(&state.actuators).enumerate() {
            let held = meets && i == 1;
            let off = (asked - reached).abs() > 0.01;
            if off != held || state.held.get(i) != Some(&held) {
                let found = format!("found {reached}, held {:?}", state.held.get(i));
                return Err(format!("actuator {i}: {found}, expected {asked}, held {held}").into());
            }
        }
    }
    Ok(())
}
