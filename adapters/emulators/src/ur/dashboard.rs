//! The dashboard server: a line in, a line out.

use tokio::io::{AsyncBufReadExt, AsyncReadExt, BufReader};
use tokio::net::TcpStream;

use super::ports::Port;
use super::robot::{Robot, Safety, mode};

/// Longest line, bytes.
const LONGEST: u64 = 4096;

pub(crate) async fn serve(port: Port, stream: TcpStream) -> std::io::Result<()> {
    let (reader, mut writer) = stream.into_split();
    let mut reader = BufReader::new(reader);
    port.faults.send(&mut writer, b"Connected: Universal Robots Dashboard Server\n").await?;
    loop {
        let mut line = Vec::new();
        if (&mut reader).take(LONGEST).read_until(b'\n', &mut line).await? == 0 {
            return Ok(());
        }
        let command = String::from_utf8_lossy(&line).trim().to_owned();
        let reply = answer(&port, &command);
        tracing::debug!(command, reply, "emulated dashboard");
        port.faults.send(&mut writer, format!("{reply}\n").as_bytes()).await?;
        if command == "quit" || command == "shutdown" {
            return Ok(());
        }
    }
}

fn mode_name(mode: i32) -> &'static str {
    match mode {
        mode::POWER_OFF => "POWER_OFF",
        mode::POWER_ON => "POWER_ON",
        mode::IDLE => "IDLE",
        mode::RUNNING => "RUNNING",
        _ => "NO_CONTROLLER",
    }
}

fn program_state(robot: &Robot) -> String {
    let state = match robot.runtime {
        2 => "PLAYING",
        4 => "PAUSED",
        _ => "STOPPED",
    };
    let name = robot.loaded.as_deref().map_or("<unnamed>", |p| p.rsplit('/').next().unwrap_or(p));
    format!("{state} {name}")
}

fn answer(port: &Port, command: &str) -> String {
    let settings = &port.settings;
    let mut robot = port.robot();
    let controls = ["power on", "power off", "brake release", "play", "pause", "stop"];
    // In local control what would move or power the arm is refused.
    if !robot.remote && (controls.contains(&command) || command.starts_with("load ")) {
        return format!("Failed to execute: {command}");
    }
    if let Some(path) = command.strip_prefix("load ") {
        let path = path.trim();
        if !path.ends_with(".urp") {
            return format!("File not found: {path}");
        }
        let path = if path.starts_with('/') { path.to_owned() } else { format!("/programs/{path}") };
        robot.loaded = Some(path.clone());
        return format!("Loading program: {path}");
    }
    if command.strip_prefix("popup ").is_some() {
        return "showing popup".into();
    }
    if command.strip_prefix("addToLog").is_some() {
        return "Added log message".into();
    }
    let failed = || format!("Failed to execute: {command}");
    match command {
        "robotmode" => format!("Robotmode: {}", mode_name(robot.mode)),
        "safetystatus" => format!("Safetystatus: {}", robot.safety().name()),
        "safetymode" => format!("Safetymode: {}", robot.safety().name()),
        "power on" if robot.power_on() => "Powering on".into(),
        "brake release" if robot.brake_release() => "Brake releasing".into(),
        "power off" => {
            robot.power_off();
            "Powering off".into()
        }
        "play" if robot.can_move() && robot.loaded.is_some() => {
            robot.runtime = 2;
            "Starting program".into()
        }
        "pause" if robot.runtime == 2 => {
            robot.runtime = 4;
            "Pausing program".into()
        }
        "stop" => {
            robot.stop_program = true;
            "Stopped".into()
        }
        "power on" | "brake release" | "play" | "pause" => failed(),
        "programState" => program_state(&robot),
        "running" => format!("Program running: {}", robot.runtime == 2),
        "get loaded program" => {
            robot.loaded.as_ref().map_or("No program loaded".into(), |p| format!("Loaded program: {p}"))
        }
        "unlock protective stop" => {
            if robot.unlock() {
                "Protective stop releasing".into()
            } else {
                "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective \
                 stop before unlocking"
                    .into()
            }
        }
        "close safety popup" => "closing safety popup".into(),
        "close popup" => "closing popup".into(),
        "restart safety" => {
            if robot.safety() == Safety::Violation {
                robot.set_safety(Safety::Normal, "safety started again");
            }
            "Restarting safety".into()
        }
        // The older series has no such mode.
        "is in remote control" if settings.version[0] >= 5 => robot.remote.to_string(),
        "PolyscopeVersion" | "version" => {
            let [major, minor, bugfix, build] = settings.version;
            format!("URSoftware {major}.{minor}.{bugfix}.{build} (Jul 12 2024)")
        }
        "get robot model" => settings.model.dashboard_name().into(),
        "get serial number" => "20195500001".into(),
        "get operational mode" => "NONE".into(),
        "shutdown" => "Shutting down".into(),
        "quit" => "Disconnected".into(),
        other => format!("could not understand: \"{other}\""),
    }
}
