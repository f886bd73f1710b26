//! `graspd emulate`: emulated devices that speak the real protocols, for anybody's client software.

use std::io::Write as _;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context as _;
use clap::{Args, Subcommand, ValueEnum};
use graspd_adapters_emulators::dynamixel::{self, BusConfig, BusEmulator};
use graspd_adapters_emulators::faults::LinkFaults;
use graspd_adapters_emulators::requests::{
    FaultRequest, FaultyDevice, befall_bus, befall_gripper, befall_ur, carry_out,
};
use graspd_adapters_emulators::robotiq::{self, Gripper, GripperConfig};
use graspd_adapters_emulators::ur::{UrEmulator, UrModel, UrPorts, UrSettings};

/// Emulates a device on its real protocol, until it is interrupted: an arm, a gripper, a hand's bus of motors.
#[derive(Debug, Clone, Args)]
pub(crate) struct EmulateArgs {
    #[command(subcommand)]
    device: Device,
}

#[derive(Debug, Clone, Subcommand)]
enum Device {
    Ur(UrArgs),
    Robotiq(RobotiqArgs),
    Leap(LeapArgs),
}

/// A Universal Robots controller: dashboard, primary, secondary and real-time interfaces, RTDE.
#[derive(Debug, Clone, Args)]
struct UrArgs {
    /// Address to listen on; 127.0.0.2 and on are this machine, too
    #[arg(long, value_name = "ADDRESS", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    listen: IpAddr,
    /// Any free ports instead of those of a controller
    #[arg(long)]
    free_ports: bool,
    /// ur3e, ur5e, ur10e, ur16e, ur3, ur5 or ur10
    #[arg(long, default_value = "ur5e", value_parser = model)]
    model: UrModel,
    /// Not in remote control: the pendant has control
    #[arg(long)]
    local: bool,
    /// Not powered at first
    #[arg(long)]
    off: bool,
    /// A fault, as `NAME[=VALUE][@AT][+LASTS]`; `--fault help` lists them. May be given many times
    #[arg(long = "fault", value_name = "FAULT")]
    faults: Vec<String>,
}

fn model(text: &str) -> Result<UrModel, String> {
    let known = UrModel::ALL.iter().find(|(_, name)| *name == text);
    known
        .map(|(model, _)| *model)
        .ok_or_else(|| format!("found {text}, expected one of {:?}", UrModel::ALL.map(|m| m.1)))
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum GripperModel {
    /// 2F-85 or 2F-140
    #[value(name = "2f")]
    TwoFinger,
    /// 3-Finger
    #[value(name = "3f")]
    ThreeFinger,
}

/// A Robotiq gripper: Modbus RTU on a serial line, Modbus TCP, RTU over TCP, the wrist socket.
#[derive(Debug, Clone, Args)]
struct RobotiqArgs {
    /// Which gripper
    #[arg(long, value_enum, default_value = "2f")]
    model: GripperModel,
    /// Address to listen on: wrist socket 63352, RTU over TCP 54321, Modbus TCP 5020 (502 would need rights). Left out: free
    /// ports of 127.0.0.1
    #[arg(long, value_name = "ADDRESS")]
    listen: Option<IpAddr>,
    /// Symbolic link to the serial line; left out: one in the folder for temporary files
    #[arg(long, value_name = "PATH")]
    link: Option<PathBuf>,
    /// A fault, as `NAME[=VALUE][@AT][+LASTS]`; `--fault help` lists them. May be given many times
    #[arg(long = "fault", value_name = "FAULT")]
    faults: Vec<String>,
}

/// The sixteen motors of a LEAP Hand on a serial line.
#[derive(Debug, Clone, Args)]
struct LeapArgs {
    /// XC330 motors instead of XL330
    #[arg(long)]
    full: bool,
    /// Symbolic link to the serial line; left out: one in the folder for temporary files
    #[arg(long, value_name = "PATH")]
    link: Option<PathBuf>,
    /// Firmware that does not know fast sync read
    #[arg(long)]
    no_fast_sync_read: bool,
    /// What a USB converter adds to each exchange, milliseconds
    #[arg(long, value_name = "MS", default_value_t = 0)]
    latency_ms: u64,
    /// A fault, as `NAME[=VALUE][@AT][+LASTS]`; `--fault help` lists them. May be given many times
    #[arg(long = "fault", value_name = "FAULT")]
    faults: Vec<String>,
}

/// Runs the command.
///
/// # Errors
/// For faults that are none, addresses that cannot be listened on, paths that are taken.
pub(crate) fn run(args: &EmulateArgs) -> anyhow::Result<()> {
    let (device, faults) = match &args.device {
        Device::Ur(args) => (FaultyDevice::Ur, &args.faults),
        Device::Robotiq(args) => (FaultyDevice::Robotiq, &args.faults),
        Device::Leap(args) => (FaultyDevice::Dynamixel, &args.faults),
    };
    if faults.iter().any(|fault| fault == "help") {
        let mut out = std::io::stdout().lock();
        writeln!(out, "NAME[=VALUE][@AT][+LASTS]: AT seconds after the start, for LASTS seconds")?;
        for (written, does) in device.faults() {
            writeln!(out, "  {written:<34} {does}")?;
        }
        if device == FaultyDevice::Ur {
            writeln!(
                out,
                "faults of links for one link alone: rtde:, dashboard: or scripts: before the name"
            )?;
        }
        return Ok(());
    }
    let faults: Vec<FaultRequest> =
        faults.iter().map(|fault| FaultRequest::parse(device, fault)).collect::<Result<_, _>>()?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(async {
        match &args.device {
            Device::Ur(args) => ur(args, faults).await,
            Device::Robotiq(args) => robotiq(args, faults).await,
            Device::Leap(args) => leap(args, faults).await,
        }
    })
}

/// Waits for the end, doing what was requested meanwhile.
async fn until_the_end(
    faults: Vec<FaultRequest>,
    befall: impl Fn(&FaultRequest, bool),
) -> anyhow::Result<()> {
    {
        let mut out = std::io::stdout().lock();
        writeln!(out, "ready; interrupt (ctrl-c) to end")?;
        out.flush()?;
    }
    let end = asked_to_end();
    let told = |request: &FaultRequest, begins: bool| {
        writeln!(std::io::stderr(), "fault {request} {}", if begins { "begins" } else { "ends" }).ok();
        befall(request, begins);
    };
    tokio::pin!(end);
    tokio::select! {
        () = carry_out(faults, told) => {}
        ended = &mut end => return ended,
    }
    end.await
}

/// Ready when the process is asked to end.
async fn asked_to_end() -> anyhow::Result<()> {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        let mut asked = signal(SignalKind::terminate()).context("signals cannot be heard")?;
        tokio::select! {
            ended = tokio::signal::ctrl_c() => ended.context("signals cannot be heard"),
            _ = asked.recv() => Ok(()),
        }
    }
    #[cfg(not(unix))]
    tokio::signal::ctrl_c().await.context("signals cannot be heard")
}

async fn ur(args: &UrArgs, faults: Vec<FaultRequest>) -> anyhow::Result<()> {
    let ports = if args.free_ports { UrPorts::FREE } else { UrPorts::default() };
    let settings = UrSettings {
        address: args.listen,
        ports,
        remote_control: !args.local,
        powered: !args.off,
        ..UrSettings::of(args.model)
    };
    let emulator = UrEmulator::start(settings).await;
    let emulator = emulator.with_context(|| {
        format!("{}: cannot listen on the controller's ports; another address, or --free-ports?", args.listen)
    })?;
    let at = emulator.addresses();
    {
        let mut out = std::io::stdout().lock();
        for (name, address) in [
            ("dashboard", at.dashboard),
            ("primary", at.primary),
            ("secondary", at.secondary),
            ("realtime", at.realtime),
            ("rtde", at.rtde),
        ] {
            writeln!(out, "{name:<10} {address}")?;
        }
        writeln!(out, "cell.toml  [arm] kind = \"ur\", address = \"{}\"", args.listen)?;
    }
    until_the_end(faults, |request, begins| befall_ur(&emulator, request, begins)).await
}

async fn robotiq(args: &RobotiqArgs, faults: Vec<FaultRequest>) -> anyhow::Result<()> {
    let three = args.model == GripperModel::ThreeFinger;
    let (model, plant) = if three {
        (robotiq::Model::ThreeFinger, robotiq::KinematicPlant::three_finger())
    } else {
        (robotiq::Model::TwoFinger, robotiq::KinematicPlant::two_finger())
    };
    let gripper = Gripper::new(GripperConfig::new(model), plant);
    let at = |port: u16| match args.listen {
        Some(address) => SocketAddr::new(address, port),
        None => SocketAddr::new(Ipv4Addr::LOCALHOST.into(), 0),
    };
    let line = gripper.serve_rtu(args.link.clone()).context("the serial line cannot be made")?;
    let cannot = |port: u16| format!("{}: cannot be listened on; another address?", at(port));
    let modbus = gripper.serve_modbus_tcp(at(5020)).await.with_context(|| cannot(5020))?;
    let rtu = gripper.serve_rtu_over_tcp(at(54321)).await.with_context(|| cannot(54321))?;
    // The 3-Finger has no wrist socket.
    let socket = match three {
        true => None,
        false => Some(gripper.serve_socket(at(63352)).await.with_context(|| cannot(63352))?),
    };
    {
        let mut out = std::io::stdout().lock();
        writeln!(out, "serial     {}", line.path().display())?;
        writeln!(out, "modbus     modbus://{}", modbus.address())?;
        writeln!(out, "rtu        rtu://{}", rtu.address())?;
        if let Some(socket) = &socket {
            writeln!(out, "socket     socket://{}", socket.address())?;
        }
        let kind = if three { "robotiq-3f" } else { "robotiq-2f" };
        writeln!(out, "cell.toml  [hand] kind = \"{kind}\", address = any of these")?;
    }
    let mut lines: Vec<LinkFaults> =
        vec![line.faults().clone(), modbus.faults().clone(), rtu.faults().clone()];
    lines.extend(socket.as_ref().map(|s| s.faults().clone()));
    until_the_end(faults, |request, begins| befall_gripper(&gripper, &lines, request, begins)).await
}

async fn leap(args: &LeapArgs, faults: Vec<FaultRequest>) -> anyhow::Result<()> {
    let config = BusConfig {
        path: args.link.clone(),
        fast_sync_read: !args.no_fast_sync_read,
        latency: Duration::from_millis(args.latency_ms),
        ..BusConfig::leap(args.full)
    };
    let bus = BusEmulator::start(config, dynamixel::KinematicPlant::new());
    let bus = bus.context("the serial line cannot be made")?;
    {
        let mut out = std::io::stdout().lock();
        let path = bus.path().display();
        writeln!(out, "serial     {path}")?;
        writeln!(out, "cell.toml  [hand] kind = \"leap\", address = \"{path}\"")?;
    }
    until_the_end(faults, |request, begins| befall_bus(&bus, request, begins)).await
}
