//! Servo streams: one grasp from frame to frame, the newest frame wins, and what is wrong is counted or named.

use std::time::Duration;

use graspd_client::wire::{self, HandPosture, Pose, ServoState, Vector3};
use graspd_client::{Client, ClientError, Code, ServoConfig, ServoFrame, ServoGraspResponse, ServoStream};
use graspd_server::ServerConfig;
use graspd_server::security::Limits;
use graspd_tests::{BoxScene, TestServer};

use crate::{GRIPPER, call_error};

/// A small first search, so that a busy machine is done with it soon.
fn config() -> ServoConfig {
    ServoConfig {
        hand: format!("hands/{GRIPPER}"),
        options: Some(wire::PlanOptions { batch_size: 32, seed: 1, ..Default::default() }),
        standoff_speed_m_s: Some(0.5),
        ..ServoConfig::default()
    }
}

/// Frame `sequence` of a camera that stands still, 20 frames a second.
fn frame(sequence: u64) -> ServoFrame {
    let mut frame = BoxScene::default().frame();
    let nanos = i32::try_from(sequence % 20 * 50_000_000).unwrap();
    frame.capture_time = Some(prost_types::Timestamp { seconds: (sequence / 20) as i64, nanos });
    ServoFrame { sequence, frame: Some(frame), hand: None }
}

async fn next(stream: &mut ServoStream) -> ServoGraspResponse {
    stream.next().await.unwrap().expect("an answer")
}

fn with(limits: Limits) -> ServerConfig {
    ServerConfig { limits, ..TestServer::config() }
}

/// What docs/servo.md shows.
async fn documented(
    client: &Client,
    camera: impl Fn(u64) -> wire::DepthFrame,
    mut follow: impl FnMut(Option<wire::PoseInFrame>),
) -> Result<Option<wire::Grasp>, ClientError> {
    let config = ServoConfig { hand: "hands/robotiq-3f".into(), ..Default::default() };
    let mut servo = client.servo_grasp(config).await?;
    for sequence in 1.. {
        servo.send(ServoFrame { sequence, frame: Some(camera(sequence)), hand: None }).await?;
        let Some(answer) = servo.next().await? else { break };
        follow(answer.standoff_pose);
        if answer.go {
            return Ok(answer.grasp); // go straight there and close
        }
    }
    Ok(None)
}

#[tokio::test]
async fn the_documented_program_follows_and_goes_in() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let mut followed = 0;
    let follow = |pose: Option<wire::PoseInFrame>| followed += usize::from(pose.is_some());
    let grasp = documented(&client, |sequence| frame(sequence).frame.unwrap(), follow).await.unwrap();
    assert!(grasp.is_some() && followed > 1, "{grasp:?} after {followed} poses");
}

#[tokio::test]
async fn a_grasp_is_planned_followed_and_gone_in_for() {
    let server = TestServer::start().await;
    let mut stream = server.client().await.servo_grasp(config()).await.unwrap();
    let mut answers = Vec::new();
    for sequence in 1..60 {
        stream.send(frame(sequence)).await.unwrap();
        let answer = next(&mut stream).await;
        assert_eq!(answer.sequence, sequence, "each is answered when it is waited for");
        assert_eq!(answer.capture_time, frame(sequence).frame.unwrap().capture_time);
        answers.push(answer);
        if answers.last().is_some_and(|a| a.go) {
            break;
        }
    }
    let (first, last) = (&answers[0], answers.last().unwrap());
    assert_eq!((first.state(), first.reason.as_str()), (ServoState::Replanning, "first"));
    assert_eq!(first.standoff_m, 0.15);
    assert!(first.age.is_some() && !first.stages.is_empty());
    assert!(last.go && last.settled && last.state() == ServoState::Tracking, "{last:?}");
    assert!((last.standoff_m - 0.05).abs() < 1e-9);
    let counters = last.counters.unwrap();
    assert_eq!((counters.answered_count, counters.superseded_count), (answers.len() as u64, 0));
    // The stand-off lies against the approach, by as much as it says.
    let at = |p: &Option<wire::PoseInFrame>| {
        let p = p.as_ref().unwrap();
        assert_eq!(p.frame_id, graspd_tests::SCENE_FRAME);
        let p = p.pose.as_ref().unwrap().position.unwrap();
        nalgebra::Vector3::new(p.x, p.y, p.z)
    };
    let apart = (at(&last.standoff_pose) - at(&last.grasp.as_ref().unwrap().wrist_pose)).norm();
    assert!((apart - last.standoff_m).abs() < 1e-9);
    for a in answers.iter().filter(|a| a.state() == ServoState::Tracking) {
        assert!(a.change_m <= 0.008 + 1e-9 && a.change_rad <= 0.06 + 1e-9, "{} {}", a.change_m, a.change_rad);
    }
    // The sender has said all: the stream ends without an error.
    let (frames, mut rest) = stream.split();
    drop(frames);
    assert_eq!(rest.next().await.unwrap(), None);
}

#[tokio::test]
async fn the_newest_frame_wins_and_nothing_is_unaccounted_for() {
    let server = TestServer::start().await;
    let (frames, mut answers) = server.client().await.servo_grasp(config()).await.unwrap().split();
    const SENT: u64 = 60;
    let sending = tokio::spawn(async move {
        for sequence in 1..=SENT {
            frames.send(frame(sequence)).await.unwrap();
        }
    });
    let mut last: Option<ServoGraspResponse> = None;
    let mut count = 0;
    while let Some(answer) = answers.next().await.unwrap() {
        assert!(last.as_ref().is_none_or(|l| l.sequence < answer.sequence), "answers go forward");
        (last, count) = (Some(answer), count + 1);
    }
    sending.await.unwrap();
    let last = last.expect("answers");
    let counters = last.counters.unwrap();
    assert_eq!(last.sequence, SENT, "the last frame is answered");
    assert_eq!(counters.answered_count, count);
    assert_eq!(counters.answered_count + counters.superseded_count + counters.shed_count, SENT);
    assert!(counters.superseded_count > 0, "sixty frames at once are more than a planner takes");
}

#[tokio::test]
async fn frames_that_cannot_be_looked_at_are_counted_and_explained() {
    let server = TestServer::start().await;
    let mut stream = server.client().await.servo_grasp(config()).await.unwrap();
    stream.send(frame(5)).await.unwrap();
    assert_eq!(next(&mut stream).await.sequence, 5);
    // Each bad frame is followed by a good one, which tells about it.
    let mut wild = frame(7);
    let pose = wild.frame.as_mut().unwrap().camera_pose.as_mut().unwrap().pose.as_mut().unwrap();
    pose.position = Some(Vector3 { x: 9.0, y: 0.0, z: 1.0 });
    let mut broken = frame(9);
    broken.frame.as_mut().unwrap().data = vec![1u8, 2, 3].into();
    let mut without_pose = frame(11);
    without_pose.frame.as_mut().unwrap().camera_pose = None;
    let mut bad_hand = frame(13);
    bad_hand.hand = Some(HandPosture { wrist_pose: None, joint_positions: vec![] });
    let mut joints_missing = frame(15);
    let camera_pose = joints_missing.frame.as_ref().unwrap().camera_pose.clone().unwrap();
    joints_missing.hand = Some(HandPosture { wrist_pose: camera_pose.pose, joint_positions: vec![0.0; 200] });
    let cases = [
        (frame(5), 6, "came before"),
        (frame(3), 8, "older"),
        (wild, 8, "world_from_camera"),
        (broken, 10, "frame.frame.data"),
        (without_pose, 12, "frame.frame.camera_pose"),
        (bad_hand, 14, "frame.hand.wrist_pose"),
        (joints_missing, 16, "frame.hand.joint_positions"),
    ];
    let mut at = 6;
    for (bad, _, why) in cases {
        // Sequence numbers of good frames go on whatever the bad ones say; wild ones keep their time.
        let mut bad = bad;
        if bad.sequence > 5 {
            bad.sequence = at;
            at += 1;
        }
        stream.send(bad).await.unwrap();
        // A frame that is replaced before it is looked at is not counted as bad: let it be looked at.
        tokio::time::sleep(Duration::from_millis(50)).await;
        server.idle_within(Duration::from_secs(60)).await;
        stream.send(frame(at)).await.unwrap();
        at += 1;
        let answer = next(&mut stream).await;
        assert!(answer.refused.contains(why), "{why:?}: {:?}", answer.refused);
    }
    stream.send(frame(at)).await.unwrap();
    let answer = next(&mut stream).await;
    assert_eq!(answer.refused, "", "told once");
    let c = answer.counters.unwrap();
    assert_eq!((c.late_count + c.repeated_count, c.wild_count, c.invalid_count), (2, 1, 4), "{c:?}");
}

#[tokio::test]
async fn a_configuration_that_cannot_be_taken_ends_the_call_with_its_field() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let ask = async |edit: fn(&mut ServoConfig)| {
        let mut wrong = config();
        edit(&mut wrong);
        call_error(client.servo_grasp(wrong).await)
    };
    let error = ask(|c| c.standoff_end_m = Some(0.4)).await;
    assert_eq!(
        (error.code, error.violations[0].field.as_str()),
        (Code::InvalidArgument, "config.standoff_end_m")
    );
    let error = ask(|c| c.hand_from_camera = Some(Pose::default())).await;
    assert_eq!(error.violations[0].field, "config.hand_from_camera.position");
    let error = ask(|c| c.hand = "hands/no-such-hand".to_owned()).await;
    assert_eq!(error.code, Code::NotFound);
    let error = ask(|c| {
        c.scene_options = Some(wire::SceneOptions { estimator: "no-such".into(), ..Default::default() })
    })
    .await;
    assert_eq!(error.code, Code::NotFound);
    // Configured twice.
    let (sender, receiver) = tokio::sync::mpsc::channel(4);
    let message = wire::servo_grasp_request::Message::Config(config());
    for _ in 0..2 {
        sender.send(wire::ServoGraspRequest { message: Some(message.clone()) }).await.unwrap();
    }
    let mut raw = wire::servo_service_client::ServoServiceClient::connect(server.endpoint()).await.unwrap();
    let mut answers =
        raw.servo_grasp(tokio_stream::wrappers::ReceiverStream::new(receiver)).await.unwrap().into_inner();
    let status = answers.message().await.unwrap_err();
    assert_eq!(status.code(), Code::InvalidArgument);
    // A frame in the place of the configuration.
    let (sender, receiver) = tokio::sync::mpsc::channel(4);
    let message = wire::servo_grasp_request::Message::Frame(frame(1));
    sender.send(wire::ServoGraspRequest { message: Some(message) }).await.unwrap();
    let status = raw.servo_grasp(tokio_stream::wrappers::ReceiverStream::new(receiver)).await.unwrap_err();
    assert_eq!(status.code(), Code::InvalidArgument);
}

#[tokio::test]
async fn streams_are_limited_and_their_places_come_back() {
    let limits = Limits { servo_streams: 1, ..Limits::default() };
    let server = TestServer::start_with(with(limits)).await;
    let client = server.client().await;
    let mut first = client.servo_grasp(config()).await.unwrap();
    let error = call_error(client.servo_grasp(config()).await);
    assert_eq!((error.code, error.reason.as_str()), (Code::ResourceExhausted, "QUOTA"));
    first.send(frame(1)).await.unwrap();
    next(&mut first).await;
    drop(first);
    server.idle_within(Duration::from_secs(60)).await;
    again(&client).await;
}

/// A place comes back when the server has noticed that its caller is gone.
async fn again(client: &Client) {
    for _ in 0..600 {
        if client.servo_grasp(config()).await.is_ok() {
            return;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    panic!("the place of a stream that was dropped does not come back");
}

#[tokio::test]
async fn a_stream_in_which_nothing_happens_is_ended() {
    let limits = Limits { servo_idle: Duration::from_millis(300), ..Limits::default() };
    let server = TestServer::start_with(with(limits)).await;
    let mut stream = server.client().await.servo_grasp(config()).await.unwrap();
    let error = call_error(stream.next().await);
    assert_eq!((error.code, error.reason.as_str()), (Code::DeadlineExceeded, "IDLE_STREAM"));
}

#[tokio::test]
async fn a_stream_that_reaches_its_deadline_says_so() {
    let server = TestServer::start().await;
    let mut raw = wire::servo_service_client::ServoServiceClient::connect(server.endpoint()).await.unwrap();
    let (sender, receiver) = tokio::sync::mpsc::channel(4);
    let message = Some(wire::servo_grasp_request::Message::Config(config()));
    sender.send(wire::ServoGraspRequest { message }).await.unwrap();
    let mut request = tonic::Request::new(tokio_stream::wrappers::ReceiverStream::new(receiver));
    request.set_timeout(Duration::from_millis(700));
    let mut answers = raw.servo_grasp(request).await.unwrap().into_inner();
    // No frame comes: the place for an answer is free, and held by whoever would answer.
    let status = answers.message().await.unwrap_err();
    assert_eq!(status.code(), Code::DeadlineExceeded, "{status:?}");
    drop(sender);
}

#[tokio::test]
async fn a_message_that_is_too_large_ends_the_stream_and_says_so() {
    let config_of_server = ServerConfig { max_message_bytes: 100 << 10, ..TestServer::config() };
    let server = TestServer::start_with(config_of_server).await;
    let mut stream = server.client().await.servo_grasp(config()).await.unwrap();
    stream.send(frame(1)).await.unwrap();
    let error = call_error(stream.next().await);
    assert_eq!((error.code, error.reason.as_str()), (Code::ResourceExhausted, "MESSAGE_TOO_LARGE"));
}

#[tokio::test]
async fn a_stream_lives_longer_than_a_request_may_take_to_arrive() {
    let receive = Duration::from_secs(4);
    let limits = Limits { receive, bytes_per_caller: 2 << 20, ..Limits::default() };
    let server = TestServer::start_with(with(limits)).await;
    let (frames, mut answers) = server.client().await.servo_grasp(config()).await.unwrap().split();
    // For more than twice that time, in which more bytes arrive than one request may have.
    let sending = tokio::spawn(async move {
        let began = std::time::Instant::now();
        let mut sequence = 0;
        while began.elapsed() < 9 * receive / 4 || sequence < 20 {
            sequence += 1;
            frames.send(frame(sequence)).await.unwrap();
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        sequence
    });
    let mut last = 0;
    while let Some(answer) = answers.next().await.unwrap() {
        last = answer.sequence;
    }
    assert_eq!(last, sending.await.unwrap());
}

#[tokio::test]
async fn dropping_a_stream_stops_its_work_and_metrics_know() {
    let metrics_listen = Some(std::net::SocketAddr::from(([127, 0, 0, 1], 0)));
    let server = TestServer::start_with(ServerConfig { metrics_listen, ..TestServer::config() }).await;
    let stalled = ServoConfig {
        scene_options: Some(wire::SceneOptions { estimator: "stalls".to_owned(), ..Default::default() }),
        ..config()
    };
    let stream = server.client().await.servo_grasp(stalled).await.unwrap();
    stream.send(frame(1)).await.unwrap();
    server.busy().await;
    drop(stream);
    server.idle_within(Duration::from_secs(60)).await;
    let mut stream = server.client().await.servo_grasp(config()).await.unwrap();
    stream.send(frame(1)).await.unwrap();
    next(&mut stream).await;
    let (_, text) = crate::telemetry::get(server.metrics.unwrap(), "/metrics").await;
    for line in [
        "graspd_servo_frames_total{outcome=\"answered\"} 1",
        "graspd_servo_streams ",
        "graspd_servo_frame_seconds_count 1",
    ] {
        assert!(text.contains(line), "{line} in\n{text}");
    }
}

/// Resident memory of this process, bytes; nothing where the system does not tell.
fn resident_bytes() -> Option<u64> {
    let statm = std::fs::read_to_string("/proc/self/statm").ok()?;
    Some(statm.split(' ').nth(1)?.parse::<u64>().ok()? * 4096)
}

/// With `GRASPD_SERVO_FRAMES=10000` the whole run; else a short one.
#[tokio::test]
async fn memory_stays_flat_over_many_frames() {
    let asked = std::env::var("GRASPD_SERVO_FRAMES").ok().and_then(|n| n.parse().ok());
    let frames: u64 = asked.unwrap_or(400);
    let server = TestServer::start().await;
    let mut stream = server.client().await.servo_grasp(config()).await.unwrap();
    let warm = frames / 4;
    let mut before = None;
    for sequence in 1..=frames {
        stream.send(frame(sequence)).await.unwrap();
        assert_eq!(next(&mut stream).await.sequence, sequence);
        if sequence == warm {
            before = resident_bytes();
        }
    }
    let Some((before, after)) = before.zip(resident_bytes()) else { return };
    let grown = after.saturating_sub(before) as f64 / 1e6;
    // Other tests of this process come and go; a leak of one depth image a frame would be 0.3 MB a frame.
    let most = if asked.is_some() { 64.0 } else { 0.3 * 0.75 * frames as f64 };
    assert!(grown < most, "{grown:.1} MB more after {} frames", frames - warm);
    eprintln!("resident memory grew by {grown:.1} MB over {} frames", frames - warm);
}
