//! Everything that reads bytes from outside, as functions of bytes: fuzz targets call them, and a test of the workspace
//! with each committed input. None may panic, run on for ever, or take memory by what a length field claims. Where bytes
//! come in pieces, it may not matter in which. Each says whether it understood anything.

use std::io::Cursor;
use std::sync::LazyLock;
use std::time::Instant;

use graspd_adapters_azure_kinect::calibration::Calibration;
use graspd_adapters_azure_kinect::recording::Recording;
use graspd_adapters_dynamixel::{Decoder, Event, Instruction, Status, fast_sync_blocks};
use graspd_adapters_emulators::line::LineDevice;
use graspd_adapters_emulators::robotiq::{Gripper, GripperConfig, KinematicPlant};
use graspd_adapters_pico_flexx::rosbridge::{depth, messages};
use graspd_adapters_robotiq::link::{Link, socket_status};
use graspd_adapters_robotiq::settings::LinkSettings;
use graspd_adapters_robotiq::{Model, RobotiqSettings};
use graspd_adapters_ur::rtde::{Package, PackageReader};
use graspd_adapters_ur::{PrimaryReader, dashboard_line};
use graspd_hands::{Hand, HandFiles};
use graspd_server::decode::{DepthEncoding, announced_size, depth as decode_depth};
use graspd_server::jobs::{JobKind, check_request};
use tokio::io::{AsyncReadExt, AsyncWriteExt};

/// Packages of RTDE from a controller, whole and byte by byte.
pub(crate) fn rtde(data: &[u8]) -> bool {
    fn all(pieces: &[&[u8]]) -> Vec<Result<Package, String>> {
        let mut reader = PackageReader::default();
        let mut found = Vec::new();
        for piece in pieces {
            reader.push(piece);
            loop {
                match reader.next_package() {
                    Ok(Some(package)) => found.push(Ok(package)),
                    Ok(None) => break,
                    Err(error) => {
                        found.push(Err(error.to_string()));
                        return found;
                    }
                }
            }
        }
        found
    }
    let whole = all(&[data]);
    let bytes: Vec<&[u8]> = data.chunks(1).collect();
    assert_eq!(whole, all(&bytes));
    whole.iter().any(Result::is_ok)
}

/// Messages of the primary interface, whole and in two pieces.
pub(crate) fn primary(data: &[u8]) -> bool {
    let mut whole = PrimaryReader::default();
    let found = whole.push(data);
    let mut pieces = PrimaryReader::default();
    let (first, second) = data.split_at(data.len() / 2);
    let mut split = pieces.push(first);
    if let Ok(before) = &mut split
        && let Ok(after) = pieces.push(second)
    {
        before.extend(after);
        if let Ok(found) = &found {
            assert_eq!(found, before);
        }
    }
    found.is_ok_and(|messages| !messages.is_empty())
}

/// An answer of the dashboard: no end of it that is cut off is taken for a line.
pub(crate) fn dashboard(data: &[u8]) -> bool {
    let found = dashboard_line(data);
    if let Some(end) = data.iter().position(|b| *b == b'\n') {
        assert_eq!(found, dashboard_line(&data[..=end]));
        assert!(matches!(dashboard_line(&data[..end]), Ok(None) | Err(_)));
    }
    matches!(found, Ok(Some(_)))
}

/// What grippers answer to our master over RTU and TCP, read as each model's status; and the same bytes as requests to an
/// emulated gripper.
pub(crate) fn modbus_rtu(data: &[u8]) -> bool {
    // Both are made once: runs are counted in millions.
    static RUNTIME: LazyLock<Option<tokio::runtime::Runtime>> =
        LazyLock::new(|| tokio::runtime::Builder::new_current_thread().enable_time().build().ok());
    let mut understood = false;
    if let Some(runtime) = &*RUNTIME {
        for (model, link) in [
            (Model::TwoFinger85, LinkSettings::Rtu { port: "-".into(), baud: 115_200 }),
            (Model::ThreeFinger, LinkSettings::Rtu { port: "-".into(), baud: 115_200 }),
            (Model::ThreeFinger, LinkSettings::ModbusTcp { address: "-".into() }),
        ] {
            let settings = RobotiqSettings {
                model,
                link,
                reply_timeout_ms: 1000,
                gap_ms: 0,
                ..RobotiqSettings::default()
            };
            let answer = runtime.block_on(async {
                let (ours, mut theirs) = tokio::io::duplex(data.len().max(512));
                let mut link = Link::attach(ours, &settings);
                let slave = async {
                    // What comes before the request is no answer to it.
                    let mut request = [0; 64];
                    if theirs.read(&mut request).await? == 0 {
                        return Ok(());
                    }
                    theirs.write_all(data).await?;
                    // Nothing comes after it: the answer is these bytes, or none.
                    theirs.shutdown().await
                };
                let (answer, _ended) = tokio::join!(link.read(), slave);
                answer.ok()
            });
            if let Some(bytes) = answer {
                understood |= model.decode(&bytes).is_ok();
            }
        }
    }
    for model in [Model::TwoFinger85, Model::TwoFinger140, Model::ThreeFinger] {
        let _refused = model.decode(data);
    }
    understood | emulated_gripper(data)
}

fn emulated_gripper(data: &[u8]) -> bool {
    use graspd_adapters_emulators::robotiq::Model;
    let mut answered = false;
    for (model, plant) in [
        (Model::TwoFinger, KinematicPlant::two_finger()),
        (Model::ThreeFinger, KinematicPlant::three_finger()),
    ] {
        let gripper = Gripper::new(GripperConfig::new(model), plant);
        let mut device = gripper.rtu_device();
        let now = Instant::now();
        answered |= !device.receive(data, now).is_empty();
        device.silence();
        for piece in data.chunks(3) {
            device.receive(piece, now);
        }
    }
    answered
}

/// Answers of the wrist socket.
pub(crate) fn wrist_socket(data: &[u8]) -> bool {
    socket_status(data).is_ok_and(|bytes| Model::TwoFinger85.decode(&bytes).is_ok())
}

/// Packets of Dynamixel protocol 2.0, both ways; what is read and written again is the same packet.
pub(crate) fn dynamixel(data: &[u8]) -> bool {
    let mut decoder = Decoder::new();
    let mut packets = Vec::new();
    decoder.push(data);
    while let Some(event) = decoder.next_event() {
        if let Event::Packet(packet) = event {
            packets.push(packet);
        }
    }
    let mut pieces = Decoder::new();
    let mut again = Vec::new();
    for piece in data.chunks(1) {
        pieces.push(piece);
        while let Some(event) = pieces.next_event() {
            if let Event::Packet(packet) = event {
                again.push(packet);
            }
        }
    }
    assert_eq!(packets, again);
    for packet in &packets {
        if let Ok(instruction) = Instruction::from_packet(packet)
            && let Ok(written) = instruction.to_packet(packet.id)
        {
            assert_eq!(Instruction::from_packet(&written).as_ref(), Ok(&instruction));
        }
        if let Ok(status) = Status::from_packet(packet) {
            assert_eq!(Status::from_packet(&status.to_packet()).as_ref(), Ok(&status));
        }
        for len in [0, 1, 4, 10] {
            let _refused = fast_sync_blocks(packet, len);
        }
        if let Ok(bytes) = packet.encode() {
            let mut decoder = Decoder::new();
            decoder.push(&bytes);
            assert_eq!(decoder.next_event(), Some(Event::Packet(packet.clone())));
        }
    }
    !packets.is_empty()
}

/// Recordings: EBML, the Matroska in it, calibration, images.
pub(crate) fn mkv(data: &[u8]) -> bool {
    let Ok(mut recording) = Recording::new(Cursor::new(data)) else { return false };
    // A file of so many bytes has no more images than these; a second reading must find the same.
    let count = |recording: &mut Recording<Cursor<&[u8]>>| {
        let mut images = 0;
        while let Ok(Some(_)) = recording.next_image() {
            images += 1;
            assert!(images <= data.len());
        }
        images
    };
    let images = count(&mut recording);
    recording.rewind();
    assert_eq!(count(&mut recording), images);
    true
}

/// The calibration that a recording carries.
pub(crate) fn calibration(data: &[u8]) -> bool {
    Calibration::from_json(data).is_ok()
}

/// Messages of rosbridge, as all that they may be.
pub(crate) fn rosbridge(data: &[u8]) -> bool {
    use messages::{CameraInfo, Envelope, Image, PointCloud2, Published};
    if serde_json::from_slice::<Envelope>(data).is_err() {
        return false;
    }
    let mut understood = false;
    if let Ok(image) = serde_json::from_slice::<Published<Image>>(data) {
        understood |= depth::of_image(&image.msg).is_ok();
        let _time = image.msg.header.stamp.since_1970();
    }
    if let Ok(cloud) = serde_json::from_slice::<Published<PointCloud2>>(data) {
        understood |= depth::of_points(&cloud.msg, 0.05).is_ok();
    }
    if let Ok(info) = serde_json::from_slice::<Published<CameraInfo>>(data) {
        understood |= depth::lens(&info.msg).is_ok();
    }
    understood
}

/// A network's file.
pub(crate) fn onnx(data: &[u8]) -> bool {
    graspd_inference::Network::from_bytes(data).is_ok()
}

/// Depth images of requests: the first byte chooses the encoding, four more a size, the rest are the pixels.
pub(crate) fn depth_frame(data: &[u8]) -> bool {
    let Some(([kind, w0, w1, h0, h1], pixels)) = data.split_first_chunk::<5>() else { return false };
    let size = (usize::from(u16::from_le_bytes([*w0, *w1])), usize::from(u16::from_le_bytes([*h0, *h1])));
    let encoding = match kind % 3 {
        0 => DepthEncoding::RawU16 { scale_m: 0.001 },
        1 => DepthEncoding::RawF32,
        _ => DepthEncoding::PngU16 { scale_m: 0.001 },
    };
    let size = (size != (0, 0)).then_some(size);
    let announced = announced_size(encoding, size, pixels);
    let decoded = decode_depth(encoding, size, pixels);
    if let (Ok(announced), Ok(decoded)) = (&announced, &decoded) {
        assert_eq!(*announced, (decoded.image.width, decoded.image.height));
    }
    // What decodes must have been announced: sizes are refused before anything is decoded.
    assert!(announced.is_ok() || decoded.is_err());
    decoded.is_ok()
}

/// A call to the planner: the first byte says which method, the rest is its message. What is refused is refused with a code
/// that blames the caller.
pub(crate) fn request(data: &[u8]) -> bool {
    let Some((method, message)) = data.split_first() else { return false };
    let kind = JobKind::ALL[usize::from(*method) % JobKind::ALL.len()];
    match check_request(kind, message) {
        Ok(()) => true,
        Err(status) => {
            // InvalidArgument, by its number: the fuzz workspace need not know gRPC.
            assert_eq!(i32::from(status.code()), 3, "{}", status.message());
            false
        }
    }
}

/// A hand that somebody uploads: its URDF up to the first zero byte, then its description.
pub(crate) fn hand(data: &[u8]) -> bool {
    let end = data.iter().position(|byte| *byte == 0).unwrap_or(data.len());
    let (urdf, description) = data.split_at(end);
    let description = description.get(1..).unwrap_or_default();
    Hand::load("fuzz", &HandFiles::new(urdf, description)).is_ok()
}
