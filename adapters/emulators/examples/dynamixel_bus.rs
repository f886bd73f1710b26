//! A bus of the motors of a LEAP Hand on a pseudo-terminal, until standard input ends.
//!
//! `cargo run -p graspd-adapters-emulators --example dynamixel_bus -- [PATH] [xl330|xc330]`

use std::io::Read;

use graspd_adapters_emulators::dynamixel::{BusConfig, BusEmulator, KinematicPlant};

fn main() -> std::io::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().map(Into::into);
    let full = arguments.next().is_none_or(|motors| motors != "xl330");
    let bus = BusEmulator::start(BusConfig { path, ..BusConfig::leap(full) }, KinematicPlant::new())?;
    println!("{}", bus.path().display());
    std::io::stdin().read_to_end(&mut Vec::new())?;
    println!("{} packets understood", bus.packets());
    Ok(())
}
