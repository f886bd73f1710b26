//! Primary, secondary and real-time interfaces: state and messages out, scripts in.

use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::sync::broadcast::error::RecvError;

use super::geometry::to_six;
use super::ports::Port;
use super::robot::{Message, Robot, Safety};
use super::script::Splitter;

/// Which of the three.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stream {
    Primary,
    Secondary,
    Realtime,
}

const STATE: u8 = 16;
const MESSAGE: u8 = 20;
/// A client that does not read for so long gets nothing more, but may still send scripts.
const SLOW_CLIENT: Duration = Duration::from_millis(200);

pub(crate) async fn serve(port: Port, kind: Stream, stream: TcpStream) -> std::io::Result<()> {
    let (mut reader, mut writer) = stream.into_split();
    let mut messages = port.robot().messages.subscribe();
    let mut splitter = Splitter::default();
    let mut buffer = [0u8; 4096];
    let period = if kind == Stream::Realtime { 20 } else { 100 };
    let mut clock = tokio::time::interval(Duration::from_millis(period));
    clock.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
    let mut reads = true;
    if kind != Stream::Realtime {
        let version = port.settings.version;
        port.faults.send(&mut writer, &framed_message(0, 254, 3, &version_text(version))).await?;
    }
    loop {
        let packet = tokio::select! {
            read = reader.read(&mut buffer) => {
                let count = read?;
                if count == 0 {
                    return Ok(());
                }
                match splitter.push(&buffer[..count]) {
                    Ok(programs) => programs.into_iter().for_each(|program| port.upload(program)),
                    Err(error) => port.robot().tell(Message::Exception { line: 0, text: error.to_string() }),
                }
                continue;
            }
            _ = clock.tick() => {
                let robot = port.robot();
                if kind == Stream::Realtime { realtime(&robot) } else { state(&robot) }
            }
            message = messages.recv() => match message {
                Ok(message) if kind == Stream::Primary => {
                    let time_us = (port.robot().time_s * 1e6) as u64;
                    message_packet(time_us, &message)
                }
                Ok(_) | Err(RecvError::Lagged(_)) => continue,
                Err(RecvError::Closed) => return Ok(()),
            },
        };
        if !reads {
            continue;
        }
        match tokio::time::timeout(SLOW_CLIENT, port.faults.send(&mut writer, &packet)).await {
            Ok(sent) => sent?,
            Err(_) => {
                // The frame is broken off in the middle: nothing after it could be understood.
                reads = false;
                let _closed = writer.shutdown().await;
            }
        }
    }
}

fn version_text(version: [u32; 4]) -> Vec<u8> {
    let mut data = vec![9];
    data.extend(b"URControl");
    data.extend([version[0] as u8, version[1] as u8]);
    data.extend((version[2] as i32).to_be_bytes());
    data.extend((version[3] as i32).to_be_bytes());
    data.extend(b"12-07-2024, 00:00:00");
    data
}

fn framed(kind: u8, body: &[u8]) -> Vec<u8> {
    let mut out = ((body.len() + 5) as i32).to_be_bytes().to_vec();
    out.push(kind);
    out.extend(body);
    out
}

fn framed_message(time_us: u64, source: u8, kind: u8, data: &[u8]) -> Vec<u8> {
    let mut body = time_us.to_be_bytes().to_vec();
    body.extend([source, kind]);
    body.extend(data);
    framed(MESSAGE, &body)
}

fn message_packet(time_us: u64, message: &Message) -> Vec<u8> {
    let mut data = Vec::new();
    let kind = match message {
        Message::Text(text) => {
            data.extend(text.bytes());
            0
        }
        Message::Key { title, text } => {
            data.extend(0i32.to_be_bytes());
            data.extend(0i32.to_be_bytes());
            let title = &title.as_bytes()[..title.len().min(255)];
            data.push(title.len() as u8);
            data.extend(title);
            data.extend(text.bytes());
            7
        }
        Message::Error { code, argument, text } => {
            data.extend(code.to_be_bytes());
            data.extend(argument.to_be_bytes());
            data.extend(3i32.to_be_bytes());
            data.extend(0u32.to_be_bytes());
            data.extend(0u32.to_be_bytes());
            data.extend(text.bytes());
            6
        }
        Message::Exception { line, text } => {
            data.extend(line.to_be_bytes());
            data.extend(0i32.to_be_bytes());
            data.extend(text.bytes());
            10
        }
    };
    framed_message(time_us, 0, kind, &data)
}

fn sub(kind: u8, data: &[u8]) -> Vec<u8> {
    let mut out = ((data.len() + 5) as u32).to_be_bytes().to_vec();
    out.push(kind);
    out.extend(data);
    out
}

/// Robot mode, joints, and the tool's pose.
fn state(robot: &Robot) -> Vec<u8> {
    let mut mode = ((robot.time_s * 1e6) as u64).to_be_bytes().to_vec();
    let safety = robot.safety();
    mode.extend([
        1,
        1,
        u8::from(robot.mode >= 4),
        u8::from(safety == Safety::EmergencyStop),
        u8::from(safety == Safety::ProtectiveStop),
        u8::from(robot.runtime == 2),
        u8::from(robot.runtime == 4),
        robot.mode as u8,
        0,
    ]);
    for fraction in [robot.slider, robot.slider, 1.0] {
        mode.extend(fraction.to_be_bytes());
    }
    mode.push(0);
    let mut joints = Vec::new();
    for i in 0..6 {
        for value in [robot.state.q[i], robot.mover.q[i], robot.state.qd[i]] {
            joints.extend(value.to_be_bytes());
        }
        for value in [0.0f32, 48.0, 30.0, 30.0] {
            joints.extend(value.to_be_bytes());
        }
        joints.push(253);
    }
    let mut pose = Vec::new();
    for value in to_six(&robot.actual_tcp()).into_iter().chain(to_six(&robot.mover.tcp())) {
        pose.extend(value.to_be_bytes());
    }
    framed(STATE, &[sub(0, &mode), sub(1, &joints), sub(4, &pose)].concat())
}

/// The fixed block of 1220 bytes of software 5.10 and later.
fn realtime(robot: &Robot) -> Vec<u8> {
    let mut values = vec![robot.time_s];
    let zero = [0.0; 6];
    for six in [robot.mover.q, robot.mover.qd, zero, zero, zero, robot.state.q, robot.state.qd, zero, zero] {
        values.extend(six);
    }
    values.extend(to_six(&robot.actual_tcp()));
    values.extend(robot.mover.tcp_twist(&robot.state.qd));
    values.extend(robot.wrench());
    values.extend(to_six(&robot.mover.base_from_tcp()));
    values.extend(robot.mover.tcp_twist(&robot.mover.qd));
    values.push(robot.digital_in as f64);
    values.extend([30.0; 6]);
    values.extend([0.0, 0.0, f64::from(robot.mode)]);
    values.extend([253.0; 6]);
    values.push(f64::from(robot.safety().number()));
    values.extend(zero);
    values.extend([0.0, 0.0, 9.81]);
    values.extend(zero);
    values.extend([robot.slider, 0.0, 0.0, 0.0, 48.0, 48.0, 0.0]);
    values.extend([48.0; 6]);
    values.extend([robot.digital_out as f64, f64::from(robot.runtime)]);
    values.resize(152, 0.0);
    let mut out = 1220i32.to_be_bytes().to_vec();
    values.iter().for_each(|v| out.extend(v.to_be_bytes()));
    out
}
