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
    /// Model: ur3e, ur5e, ur10e, ur5.
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
    let model = match args.model.as_str() {
        "ur3e" => UrModel::Ur3e,
        "ur5e" => UrModel::Ur5e,
        "ur10e" => UrModel::Ur10e,
        "ur5" => UrModel::Ur5,
        other => return Err(format!("--model: found {other}, expected ur3e, ur5e, ur10e or ur5").into()),
    };
    let settings = UrSettings {
        model,
        address: args.address,
        remote_control: !args.local,
        powered: !args.off,
        ..UrSettings::default()
    };
    let emulator = UrEmulator::start(settings).await?;
    println!("listening {:?}", emulator.addresses());
    tokio::signal::ctrl_c().await?;
    Ok(())
}
