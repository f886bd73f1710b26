//! A Robotiq gripper on a pseudo-terminal, Modbus TCP, RTU over TCP and the wrist socket, until standard input ends.
//! Prints one line for each: its name and where it is.
//!
//! `cargo run -p graspd-adapters-emulators --example robotiq_gripper -- [2f|3f] [ADDRESS [PATH]]`
//!
//! With an address, for example 127.0.0.9, servers take their usual ports: 502 would need rights, so Modbus TCP is on
//! 5020; RTU over TCP on 54321; the wrist socket on 63352. Without one they take free ports.

use std::io::Read;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use graspd_adapters_emulators::robotiq::{Gripper, GripperConfig, KinematicPlant, Model};

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let three = arguments.first().is_some_and(|model| model == "3f");
    let (model, plant) = if three {
        (Model::ThreeFinger, KinematicPlant::three_finger())
    } else {
        (Model::TwoFinger, KinematicPlant::two_finger())
    };
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
    tokio::task::spawn_blocking(|| std::io::stdin().read_to_end(&mut Vec::new())).await??;
    Ok(())
}
