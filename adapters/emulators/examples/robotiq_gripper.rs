//! A Robotiq gripper on a pseudo-terminal, Modbus TCP, RTU over TCP and the wrist socket, until standard input ends.
//! Prints one line for each: its name and where it is.
//!
//! `cargo run -p graspd-adapters-emulators --example robotiq_gripper -- [2f|3f] [ADDRESS [PATH]]`
//!
//! With an address, for example 127.0.0.9, servers take their usual ports: 502 would need rights, so Modbus TCP is on
//! 5020; RTU over TCP on 54321; the wrist socket on 63352. Without one they take free ports.
//!
//! Lines of standard input say what befalls it: `object AXIS COUNT` and `object AXIS none` put something between the
//! fingers, by the motors' numbers, or take it away; `fault CODE` gives it a fault.

use std::io::BufRead;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use graspd_adapters_emulators::robotiq::{Gripper, GripperConfig, KinematicPlant, Model, Objects};

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let three = arguments.first().is_some_and(|model| model == "3f");
    let (model, plant) = if three {
        (Model::ThreeFinger, KinematicPlant::three_finger())
    } else {
        (Model::TwoFinger, KinematicPlant::two_finger())
    };
    let objects = plant.objects();
    let gripper = Gripper::new(GripperConfig::new(model), plant);
    let at = |port: u16| match arguments.get(1) {
        Some(address) => Ok::<_, std::net::AddrParseError>(SocketAddr::new(address.parse::<IpAddr>()?, port)),
        None => Ok(SocketAddr::new(Ipv4Addr::LOCALHOST.into(), 0)),
    };
    let line = gripper.serve_rtu(arguments.get(2).map(Into::into))?;
    let tcp = gripper.serve_modbus_tcp(at(5020)?).await?;
    let rtu_over_tcp = gripper.serve_rtu_over_tcp(at(54321)?).await?;
    println!("rtu {}", line.path().display());
    println!("modbus_tcp {}", tcp.address());
    println!("rtu_over_tcp {}", rtu_over_tcp.address());
    // The 3-Finger has no wrist socket.
    let socket = if three { None } else { Some(gripper.serve_socket(at(63352)?).await?) };
    if let Some(socket) = &socket {
        println!("socket {}", socket.address());
    }
    println!("ready");
    let listening = tokio::task::spawn_blocking(move || {
        for line in std::io::stdin().lock().lines() {
            let line = line?;
            if befall(&gripper, &objects, &line).is_none() {
                eprintln!("found {line:?}, expected `object AXIS COUNT|none` or `fault CODE`");
            }
        }
        Ok::<_, std::io::Error>(())
    });
    listening.await??;
    Ok(())
}

/// Lets a line befall the gripper; `None` for a line that says nothing.
fn befall(gripper: &Gripper, objects: &Objects, line: &str) -> Option<()> {
    match line.split_whitespace().collect::<Vec<_>>()[..] {
        ["object", axis, "none"] => objects.between(axis.parse().ok()?, None),
        ["object", axis, count] => objects.between(axis.parse().ok()?, Some(count.parse().ok()?)),
        ["fault", code] => gripper.fault(code.parse().ok()?),
        _ => return None,
    }
    Some(())
}
