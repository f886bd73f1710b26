//! Messages as rclpy writes them (Kilted, `rclpy.serialization.serialize_message`): four bytes that say "CDR, little-endian", then
//! the message. Ours must be the same to the byte, in both directions. Dots are padding: bytes that differ from one run of rclpy to
//! the next.

use ros2_client::dds::rustdds::serialization::{
    RepresentationIdentifier, deserialize_from_cdr_with_rep_id, to_writer_with_rep_id,
};

use super::*;

const TEXT: &str = "\
    00010000030000007b7d00";
const IMAGE: &str = "\
    000100001100000080b2e60e0400000063616d0002000000010000000600000031365543310000..030000000600000001020304\
    0506";
const CAMERA_INFO: &str = "\
    000100001100000080b2e60e0400000063616d0002000000030000000a000000706c756d625f626f6200....01000000........\
    000000000000e03f0000000000000000000000000000f03f00000000000000400000000000000840000000000000104000000000\
    0000144000000000000018400000000000001c400000000000002040000000000000f03f00000000000000000000000000000000\
    0000000000000000000000000000f03f000000000000000000000000000000000000000000000000000000000000f03f00000000\
    00000000000000000000e03f000000000000f03f000000000000f83f000000000000004000000000000004400000000000000840\
    0000000000000c400000000000001040000000000000124000000000000014400000000000001640010000000200000001000000\
    02000000030000000400000001";
const JOINT_STATE: &str = "\
    000100001100000080b2e60e0400000063616d0002000000020000006100....040000006263640002000000000000000000d03f\
    000000000000f0bf0000000000000000................";
const POINT_STAMPED: &str = "\
    000100001100000080b2e60e0400000063616d00000000000000f03f00000000000000c0000000000000e03f";
const POSE_ARRAY: &str = "\
    000100001100000080b2e60e0400000063616d0002000000........000000000000f03f00000000000000c0000000000000e03f\
    000000000000000000000000000000000000000000000000000000000000f03f000000000000f03f00000000000000c000000000\
    0000e03f000000000000000000000000000000000000000000000000000000000000f03f";
const POSE_STAMPED: &str = "\
    000100001100000080b2e60e0400000063616d00000000000000f03f00000000000000c0000000000000e03f0000000000000000\
    00000000000000000000000000000000000000000000f03f";
const JOINT_TRAJECTORY: &str = "\
    000100001100000080b2e60e0400000063616d0001000000020000006100....0200000001000000........000000000000d03f\
    000000000000000000000000010000000065cd1d01000000000000000000e03f0000000000000000000000000300000000000000\
    ........................................................";
const MARKER_ARRAY: &str = "\
    00010000020000001100000080b2e60e0400000063616d000500000068616e6400......070000000b00000000000000........\
    000000000000f03f00000000000000c0000000000000e03f00000000000000000000000000000000000000000000000000000000\
    0000f03f000000000000f03f000000000000004000000000000008400000803f0000003f0000803e0000403f0100000000000000\
    01......01000000000000000000f03f00000000000000400000000000000840000000000100000000......0000000000000000\
    0100000000......0100000000......000000000000000003000000686900..0100000000......0100000000......00000000\
    00......00000000000000000100000000......0100000000......000000000000000003000000000000000000000000000000\
    000000000000000000000000000000000000000000000000000000000000000000000000000000000000f03f0000000000000000\
    0000000000000000000000000000000000000000000000000000000000000000000000000000000000......0000000000000000\
    0100000000......00000000000000000100000000......0100000000......00000000000000000100000000......01000000\
    00......0100000000......0000000000";
const DIAGNOSTIC_ARRAY: &str = "\
    000100001100000080b2e60e0400000063616d000100000001......020000006e00....020000006d00....020000006800....\
    01000000020000006b00....03000000767600";
const TRIGGER_RESPONSE: &str = "\
    0001000001..0000030000007b7d00";
const TRIGGER_REQUEST: &str = "\
    0001000000..0000";

/// Bytes, and which of them count.
fn bytes(hex: &str) -> Vec<Option<u8>> {
    let digits: Vec<char> = hex.chars().collect();
    let byte = |pair: &[char]| match pair {
        ['.', '.'] => None,
        pair => Some(u8::from_str_radix(&pair.iter().collect::<String>(), 16).unwrap()),
    };
    digits.chunks(2).map(byte).collect()
}

#[track_caller]
fn same<T>(message: &T, golden: &str)
where
    T: serde::Serialize + serde::de::DeserializeOwned + PartialEq + std::fmt::Debug,
{
    let golden = bytes(golden);
    assert_eq!(golden[..4], [0, 1, 0, 0].map(Some));
    let golden = &golden[4..];
    let mut written = Vec::new();
    to_writer_with_rep_id(&mut written, message, RepresentationIdentifier::CDR_LE).unwrap();
    // rclpy reserves a few bytes too many for each empty sequence: what is behind the message is padding.
    assert!(written.len() <= golden.len() && golden.len() <= written.len() + 32, "{message:?}");
    for (at, (ours, theirs)) in written.iter().zip(golden).enumerate() {
        assert!(theirs.is_none_or(|theirs| theirs == *ours), "byte {at} of {message:?}: {ours}, {theirs:?}");
    }
    // Whatever stands in the padding, it is read as the same message.
    let filled: Vec<u8> = golden.iter().map(|b| b.unwrap_or(0xAA)).collect();
    let (read, count): (T, usize) =
        deserialize_from_cdr_with_rep_id(&filled, RepresentationIdentifier::CDR_LE).unwrap();
    assert_eq!((&read, count), (message, written.len()));
    // Cut short anywhere it is an error, not a panic.
    for length in 0..written.len() {
        let cut = deserialize_from_cdr_with_rep_id::<T>(&written[..length], RepresentationIdentifier::CDR_LE);
        assert!(cut.is_err(), "{length} of {} bytes", written.len());
    }
}

fn header() -> Header {
    Header { stamp: Stamp { sec: 17, nanosec: 250_000_000 }, frame_id: "cam".into() }
}

fn pose() -> Pose {
    Pose { position: Point { x: 1.0, y: -2.0, z: 0.5 }, orientation: Quaternion::default() }
}

#[test]
fn texts_and_triggers() {
    same(&Text { data: "{}".into() }, TEXT);
    same(&TriggerRequest::default(), TRIGGER_REQUEST);
    same(&TriggerResponse { success: true, message: "{}".into() }, TRIGGER_RESPONSE);
}

#[test]
fn what_cameras_send() {
    let image = Image {
        header: header(),
        height: 2,
        width: 1,
        encoding: "16UC1".into(),
        is_bigendian: 0,
        step: 3,
        data: vec![1, 2, 3, 4, 5, 6],
    };
    same(&image, IMAGE);
    let info = CameraInfo {
        header: header(),
        height: 2,
        width: 3,
        distortion_model: "plumb_bob".into(),
        d: vec![0.5],
        k: std::array::from_fn(|i| i as f64),
        r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: std::array::from_fn(|i| i as f64 / 2.0),
        binning_x: 1,
        binning_y: 2,
        roi: RegionOfInterest { x_offset: 1, y_offset: 2, height: 3, width: 4, do_rectify: true },
    };
    same(&info, CAMERA_INFO);
}

#[test]
fn poses_and_joints() {
    same(&PointStamped { header: header(), point: pose().position }, POINT_STAMPED);
    same(&PoseStamped { header: header(), pose: pose() }, POSE_STAMPED);
    same(&PoseArray { header: header(), poses: vec![pose(); 2] }, POSE_ARRAY);
    let state = JointState {
        header: header(),
        name: vec!["a".into(), "bcd".into()],
        position: vec![0.25, -1.0],
        ..JointState::default()
    };
    same(&state, JOINT_STATE);
    let point = |position, sec, nanosec| JointTrajectoryPoint {
        positions: vec![position],
        time_from_start: Duration { sec, nanosec },
        ..JointTrajectoryPoint::default()
    };
    let trajectory = JointTrajectory {
        header: header(),
        joint_names: vec!["a".into()],
        points: vec![point(0.25, 1, 500_000_000), point(0.5, 3, 0)],
    };
    same(&trajectory, JOINT_TRAJECTORY);
}

#[test]
fn markers_and_diagnostics() {
    let marker = Marker {
        header: header(),
        ns: "hand".into(),
        id: 7,
        kind: shape::TRIANGLE_LIST,
        action: action::ADD,
        pose: pose(),
        scale: Vector3 { x: 1.0, y: 2.0, z: 3.0 },
        color: ColorRGBA { r: 1.0, g: 0.5, b: 0.25, a: 0.75 },
        lifetime: Duration { sec: 1, nanosec: 0 },
        frame_locked: true,
        points: vec![Point { x: 1.0, y: 2.0, z: 3.0 }],
        text: "hi".into(),
        ..Marker::default()
    };
    let clear = Marker { action: action::DELETEALL, ..Marker::default() };
    same(&MarkerArray { markers: vec![marker, clear] }, MARKER_ARRAY);
    let status = DiagnosticStatus {
        level: level::WARN,
        name: "n".into(),
        message: "m".into(),
        hardware_id: "h".into(),
        values: vec![KeyValue { key: "k".into(), value: "vv".into() }],
    };
    same(&DiagnosticArray { header: header(), status: vec![status] }, DIAGNOSTIC_ARRAY);
}
