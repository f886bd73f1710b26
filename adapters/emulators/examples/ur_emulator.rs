//! An emulated arm on the ports of a real one, for clients of all kinds.
//!
//! `cargo run -p graspd-adapters-emulators --example ur_emulator -- --address 127.0.0.9 [--local] [--off]`

use std::net::IpAddr;

use clap::Parser;
use graspd_adapters_emulators::ur::{UrEmulator, UrModel, UrSettings};

#[derive(Debug, Parser)]
struct Args {
    /// Address to listen on.
    #[arg(long, default_value = "127.0.0.1")]
    address: IpAddr,
    /// Model, for example ur3e or ur10.
    #[arg(long, default_value = "ur5e")]
    model: String,
    /// Not in remote control.
    #[arg(long)]
    local: bool,
    /// Not powered at first.
    #[arg(long)]
    off: bool,
}

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    tracing_subscriber::fmt().with_env_filter(tracing_subscriber::EnvFilter::from_default_env()).init();
    let args = Args::parse();
    let named = UrModel::ALL.iter().find(|(_, name)| *name == args.model);
    let Some((model, _)) = named.copied() else {
        return Err(format!("--model: found {}, expected one of {:?}", args.model, UrModel::ALL).into());
    };
    let settings = UrSettings {
        address: args.address,
        remote_control: !args.local,
        powered: !args.off,
        ..UrSettings::of(model)
    };
    let emulator = UrEmulator::start(settings).await?;
    println!("listening {:?}", emulator.addresses());
    tokio::signal::ctrl_c().await?;
    Ok(())
}
