//! Wrong input over the socket: exact code, reason and field for each, and the server goes on.

use std::time::Duration;

use graspd_client::{Client, Code, DepthFrame, PlanGraspsRequest, PlanMultiHandRequest, PlanOptions};
use graspd_proto::v1;
use graspd_server::ServerConfig;
use graspd_tests::{BoxScene, PANICS, TestServer};
use tonic::transport::Channel;

use crate::{GRIPPER, call_error, request, request_with};

fn edited(edit: impl FnOnce(&mut DepthFrame)) -> PlanGraspsRequest {
    let mut request = request(GRIPPER);
    edit(&mut request.frames[0]);
    request
}

fn camera_pose(edit: impl FnOnce(&mut v1::Quaternion)) -> PlanGraspsRequest {
    edited(|frame| {
        let pose = frame.camera_pose.as_mut().and_then(|p| p.pose.as_mut());
        edit(pose.and_then(|p| p.orientation.as_mut()).unwrap());
    })
}

/// A PNG of the scene, cut in half.
fn truncated_png() -> Vec<u8> {
    let scene = BoxScene::default();
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, 320, 240);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    let pixels: Vec<u8> = scene.depth_m().iter().flat_map(|d| ((d * 1000.0) as u16).to_be_bytes()).collect();
    encoder.write_header().unwrap().write_image_data(&pixels).unwrap();
    file.truncate(file.len() / 2);
    file
}

/// The server answers an ordinary call.
async fn goes_on(client: &Client) {
    assert!(!client.list_hands().await.unwrap().is_empty());
    let answer = client.plan_grasps(&request(GRIPPER)).await.unwrap();
    assert_eq!(answer.stats.unwrap().hand, format!("hands/{GRIPPER}"));
}

#[tokio::test]
async fn every_wrong_request_is_refused_with_its_reason_and_field() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let cases: Vec<(&str, PlanGraspsRequest, Code, &str, &str)> = vec![
        (
            "too few bytes",
            edited(|f| f.data = f.data.slice(..1000)),
            Code::InvalidArgument,
            "INVALID_IMAGE",
            "frames[0].data",
        ),
        (
            "another width",
            edited(|f| f.width_px = 321),
            Code::InvalidArgument,
            "INVALID_IMAGE",
            "frames[0].data",
        ),
        (
            "no frame",
            PlanGraspsRequest { frames: vec![], ..request(GRIPPER) },
            Code::InvalidArgument,
            "MISSING_FIELD",
            "frames",
        ),
        (
            "no focal length",
            edited(|f| f.intrinsics.as_mut().unwrap().fx_px = 0.0),
            Code::InvalidArgument,
            "INVALID_INTRINSICS",
            "frames[0].intrinsics.fx_px",
        ),
        (
            "a pose that stretches",
            camera_pose(|q| q.w += 0.1),
            Code::InvalidArgument,
            "INVALID_POSE",
            "frames[0].camera_pose.pose.orientation",
        ),
        (
            "a pose that is not a number",
            camera_pose(|q| q.x = f64::NAN),
            Code::InvalidArgument,
            "INVALID_POSE",
            "frames[0].camera_pose.pose.orientation",
        ),
        (
            "half a PNG",
            edited(|f| {
                f.encoding = v1::DepthEncoding::PngU16.into();
                f.depth_scale_m = 0.001;
                f.data = truncated_png().into();
            }),
            Code::InvalidArgument,
            "INVALID_IMAGE",
            "frames[0].data",
        ),
        (
            "no candidate",
            PlanGraspsRequest {
                options: Some(PlanOptions { batch_size: -1, ..PlanOptions::default() }),
                ..request(GRIPPER)
            },
            Code::InvalidArgument,
            "INVALID_VALUE",
            "options.batch_size",
        ),
        (
            "not a name",
            PlanGraspsRequest { hand: "leap".to_owned(), ..request(GRIPPER) },
            Code::InvalidArgument,
            "INVALID_VALUE",
            "hand",
        ),
        ("an unknown hand", request("no-such-hand"), Code::NotFound, "HAND_NOT_FOUND", ""),
        ("an unknown estimator", request_with("oracle"), Code::NotFound, "ESTIMATOR_NOT_FOUND", ""),
    ];
    for (name, wrong, code, reason, field) in cases {
        let error = call_error(client.plan_grasps(&wrong).await);
        let found = error.violations.first().map_or("", |v| v.field.as_str());
        assert_eq!((error.code, error.reason.as_str(), found), (code, reason, field), "{name}: {error:?}");
        assert!(error.message.contains("expected") || code == Code::NotFound, "{name}: {}", error.message);
    }
    let twice = PlanMultiHandRequest {
        frames: vec![BoxScene::default().frame()],
        tasks: vec![
            v1::HandTask { task_id: "a".to_owned(), hand: format!("hands/{GRIPPER}"), options: None };
            2
        ],
        ..PlanMultiHandRequest::default()
    };
    let error = call_error(client.plan_multi_hand(&twice).await);
    assert_eq!((error.code, error.violations[0].field.as_str()), (Code::InvalidArgument, "tasks[1].task_id"));
    let error = call_error(client.stream_grasps(&edited(|f| f.height_px = -1)).await);
    assert_eq!(error.violations[0].field, "plan.frames[0].height_px");
    goes_on(&client).await;
}

#[tokio::test]
async fn a_frame_of_nothing_but_nan_is_an_answer_and_infinities_are_counted() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let all = |value: f32| edited(|f| f.data = value.to_le_bytes().repeat(320 * 240).into());
    let blind = client.plan_grasps(&all(f32::NAN)).await.unwrap();
    assert!(blind.grasps.is_empty());
    assert_eq!(blind.no_grasp.unwrap().reason(), v1::NoGraspReason::NothingSeen);
    assert_eq!(blind.stats.unwrap().invalid_pixel_count, 0);
    for value in [f32::INFINITY, -1.0] {
        let stats = client.plan_grasps(&all(value)).await.unwrap().stats.unwrap();
        assert_eq!(stats.invalid_pixel_count, 320 * 240, "{value}");
    }
}

#[tokio::test]
async fn a_message_over_the_limit_is_refused_with_the_limit() {
    let config = ServerConfig { max_message_bytes: 64 << 10, ..TestServer::config() };
    let small = TestServer::start_with(config).await;
    let client = small.client().await;
    let error = call_error(client.plan_grasps(&request(GRIPPER)).await);
    assert_eq!((error.code, error.reason.as_str()), (Code::ResourceExhausted, "MESSAGE_TOO_LARGE"));
    assert_eq!(error.metadata["limit_bytes"], "65536");
    assert_eq!(error.retry_after, None, "the same message will not become smaller");
    assert!(!client.list_hands().await.unwrap().is_empty());

    let server = TestServer::start().await;
    let client = server.client().await;
    let huge = edited(|f| f.data = vec![0; 17 << 20].into());
    let error = call_error(client.plan_grasps(&huge).await);
    assert_eq!((error.code, error.reason.as_str()), (Code::ResourceExhausted, "MESSAGE_TOO_LARGE"));
    assert_eq!(error.metadata["limit_bytes"], (16 << 20).to_string());
    goes_on(&client).await;
}

#[tokio::test]
async fn bytes_that_are_not_the_protocol_are_refused() {
    let server = TestServer::start().await;
    let channel = Channel::from_shared(server.endpoint()).unwrap().connect().await.unwrap();
    let mut grpc = tonic::client::Grpc::new(channel);
    grpc.ready().await.unwrap();
    // A message whose first field is bytes that are not UTF-8, where the protocol has a string.
    let codec = tonic_prost::ProstCodec::<Vec<u8>, v1::PlanGraspsResponse>::default();
    let path = "/graspd.v1.PlannerService/PlanGrasps".parse().unwrap();
    let status = grpc.unary(tonic::Request::new(vec![0xff, 0xfe]), path, codec).await.unwrap_err();
    let error = graspd_client::CallError::from(&status);
    assert_eq!((error.code, error.reason.as_str()), (Code::InvalidArgument, "MALFORMED_MESSAGE"));
    goes_on(&server.client().await).await;
}

#[tokio::test]
async fn a_method_that_does_not_exist_is_named() {
    let server = TestServer::start().await;
    let channel = Channel::from_shared(server.endpoint()).unwrap().connect().await.unwrap();
    let mut grpc = tonic::client::Grpc::new(channel);
    for path in
        ["/graspd.v1.PlannerService/PlanGrasp", "/graspd.v2.PlannerService/PlanGrasps", "/other/Method"]
    {
        grpc.ready().await.unwrap();
        let codec = tonic_prost::ProstCodec::<v1::PlanGraspsRequest, v1::PlanGraspsResponse>::default();
        let asked = tonic::Request::new(request(GRIPPER));
        let status = grpc.unary(asked, path.parse().unwrap(), codec).await.unwrap_err();
        let error = graspd_client::CallError::from(&status);
        assert_eq!((error.code, error.reason.as_str()), (Code::Unimplemented, "METHOD_NOT_FOUND"), "{path}");
        assert!(error.message.contains(path), "{}", error.message);
    }
    goes_on(&server.client().await).await;
}

#[tokio::test]
async fn a_small_png_of_many_pixels_is_refused_before_it_is_decoded() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, 4096, 4096);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    encoder.write_header().unwrap().write_image_data(&vec![0; 4096 * 4096 * 2]).unwrap();
    assert!(file.len() < 200_000, "{}", file.len());
    let bomb = edited(|f| {
        f.encoding = v1::DepthEncoding::PngU16.into();
        f.depth_scale_m = 0.001;
        (f.width_px, f.height_px) = (0, 0);
        f.data = file.into();
    });
    let error = call_error(client.plan_grasps(&bomb).await);
    assert_eq!((error.code, error.reason.as_str()), (Code::InvalidArgument, "INVALID_IMAGE"));
    assert_eq!(error.violations[0].field, "frames[0].data");
    assert!(error.message.contains("at most 8388608 pixels"), "{}", error.message);
    goes_on(&client).await;
}

#[tokio::test]
async fn a_job_that_panics_is_one_answer_and_no_more() {
    let server = TestServer::start().await;
    let client = server.client().await;
    for _ in 0..5 {
        let error = call_error(client.plan_grasps(&request_with(PANICS)).await);
        assert_eq!((error.code, error.reason.as_str()), (Code::Internal, "JOB_PANICKED"));
    }
    server.idle_within(Duration::from_secs(10)).await;
    goes_on(&client).await;
}
